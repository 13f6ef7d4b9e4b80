# SPDX-License-Identifier: Apache-2.0
"""Where the frames of a run come from, and which parameters of which nodes follow from that."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field
from dataclasses import replace
import os
from pathlib import Path

from lowsnr_bringup.plan import graph
from lowsnr_bringup.plan.graph import Layer
from lowsnr_bringup.plan.graph import Values
from lowsnr_bringup.plan.recorded_frames import RecordedRun
from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_common.settings.frame_period import at_frame_period
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.text import did_you_mean
from lowsnr_detect.parts.cell_detector import CellDetector
from lowsnr_sensor.conditioning.conditioner import ConditioningSettings
from lowsnr_sensor.scenario import load_scenario

Given = Callable[[str], Values]  # the parameters that the user gives to a node
Look = Callable[[str], RecordedRun]  # what the camera on a topic shows
_FRAMES = ('/image_raw', '/clock')
_TRUTH = ('/ground_truth', '/ground_truth/odometry')
_DETECTABLE = '32FC1'
_LEAST = 2  # pixels along each side of a frame that is conditioned
# The operating point whose threshold is simulated: for real frames it is adaptive instead.
MATCHED = 'matched'


@dataclass(frozen=True, kw_only=True)
class Source:
    """
    The origin of the frames of a run: a scenario, a bag, or a camera.

    The configuration files win over ``defaults``; ``facts`` win over the configuration files.
    """

    name: str  # of the scenario, of the recorded one, or of the camera
    node: str  # that publishes the frames, 'sensor' or 'player'; empty for a camera
    camera: str = ''  # topic of the camera
    frames: int  # 0 for a camera, which has no last one
    fastest_mps: float = 0.0  # speed of the fastest object of a scenario
    conditioned: bool = False  # whether the frames pass a conditioner
    notes: tuple[str, ...] = ()  # what is wrong with the bag, one line each
    defaults: Layer = field(default_factory=dict)
    facts: Layer


def find_source(
    options: RunOptions, config_folder: Path, given: Given, look: Look | None,
    array: RecordedRun | None = None,
) -> Source:
    """
    Find the source that the options name, or an array, and return what a run must know of it.

    Raises
    ------
    ValueError
        One line that names the scenario, bag or camera and why it cannot be used.

    """
    if array is not None:
        return _recorded(array, options, given, node='player', recordable=[])
    if options.camera is not None:
        assert look is not None
        shown, topic = look(options.camera_topic), options.camera_topic
        return _recorded(shown, options, given, node='', recordable=[topic])
    if options.replay is not None:
        from lowsnr_bringup.bags.recorded_run import inspect_bag  # slow to import
        bag = inspect_bag(options.replay, options.frames_topic, options.truth_topic)
        if options.truth_bag is not None:
            bag = replace(bag, truth=True)
        recordable = [*_FRAMES, *(_TRUTH if bag.truth else ())]
        return _recorded(bag, options, given, node='player', recordable=recordable)
    sensor = given('sensor')
    path = find_scenario(options.scenario, config_folder / 'scenarios')
    units = sensor.get('sensor.frame_period_s', 1.0), sensor.get('sensor.cell_size_m', 1.0)
    scenario = load_scenario(path, *units)
    return Source(
        name=path.stem, node='sensor', frames=scenario.frames, fastest_mps=max(
            (item.fastest_mps(scenario, *units) for item in scenario.objects), default=0.0),
        defaults={graph.EVERY_NODE: {
            'sensor.snr_db': scenario.snr_db, 'rows': scenario.rows, 'cols': scenario.cols}},
        facts={'sensor': {'scenario': str(path.resolve())},
               'recorder': {'topics': [*_FRAMES, *_TRUTH]}})


def find_scenario(text: str, folder: Path) -> Path:
    """
    Return the file of a scenario, given by name or path.

    Raises
    ------
    ValueError
        If there is none; names those of the folder.

    """
    for path in (folder / f'{text}.yaml', Path(text)):
        if os.path.isfile(path):  # unlike Path.is_file it takes a name of any length
            return path
    known = sorted(item.stem for item in folder.glob('*.yaml'))
    raise ValueError(
        f'scenario {text!r} is neither a file nor one of {", ".join(known)}'
        + did_you_mean(text, known))


def _recorded(
    found: RecordedRun, options: RunOptions, given: Given, *, node: str, recordable: list[str],
) -> Source:
    """Return the source that a bag or a camera is, from what was found in its frames."""
    conditioned = _is_conditioned(found, options)
    size = {'rows': found.rows, 'cols': found.cols}
    every: Values = {
        **size, 'truth': found.truth,
        **(found.sensor or {'sensor.frame_period_s': found.period_s})}
    if found.compressed:
        every['compressed'] = True
    if found.seed is not None:
        every['seed'] = found.seed
    if conditioned:
        settings = graph.build(ConditioningSettings, given('conditioner'), 'conditioner')
        rows, cols = settings.size((found.rows, found.cols))
        every |= {'rows': rows, 'cols': cols, 'sensor.noise_std': 1.0}
    facts: dict[str, Values] = {
        graph.EVERY_NODE: every, 'recorder': {**size, 'topics': recordable}}
    if conditioned:
        facts['conditioner'] = dict(size)
        facts['evaluator'] = _in_pixels(given('evaluator'), settings.binning)
    if options.replay is not None:
        facts['player'] = _played(options, found) | size
    if not found.simulated:
        facts.setdefault('evaluator', {})['pixels'] = True
        facts.update(_adaptive(options.detectors, given))
        for name in (*graph.KINDS, *map(graph.node_of, options.detectors)):
            for cls in graph.settings_classes(name):
                facts.setdefault(name, {}).update(
                    at_frame_period(cls, given(name), found.period_s))
    return Source(
        name=found.name, node=node, camera=options.camera_topic, frames=found.frames,
        conditioned=conditioned, notes=found.notes, facts=facts)


def _played(options: RunOptions, found: RecordedRun) -> Values:
    """Return what the player publishes."""
    assert options.replay is not None
    played: Values = {
        'bag': str(options.replay.resolve()), 'simulated': found.simulated,
        'frames_topic': found.frames_topic,
        'truth_topic': options.truth_topic if found.truth else ''}
    if options.truth_bag is not None:
        played |= {'truth_bag': str(options.truth_bag.resolve()), 'truth_topic': _TRUTH[0]}
    if found.left_out:  # an empty list has no type in a file of parameters
        played['left_out'] = list(found.left_out)
    return played


def _in_pixels(evaluator: Values, binning: int) -> Values:
    """Return the distances of the evaluator, which are those of cells, in pixels of the frame."""
    own = graph.build(Evaluation, evaluator, 'evaluator')
    return {
        'gate_cells': binning * own.gate_cells,
        'gospa_cutoff_cells': binning * own.gospa_cutoff_cells}


def _adaptive(detectors: Sequence[str], given: Given) -> dict[str, Values]:
    """Return the operating point of detectors that would be matched to simulated frames."""
    matched = [
        name for name in map(graph.node_of, detectors)
        if given(name).get('operating_point', MATCHED) == MATCHED]
    return {
        name: {'operating_point': 'adaptive'} for name in matched
        if issubclass(graph.settings_classes(name)[-1], CellDetector)}


def _is_conditioned(found: RecordedRun, options: RunOptions) -> bool:
    """Return whether the frames of a bag or camera pass a conditioner."""
    conditioned = found.raw if options.condition == 'auto' else options.condition == 'on'
    if conditioned and options.camera_topic == f'{graph.CONDITIONED}image_raw':
        raise ValueError(
            f'--camera: a run publishes {options.camera} itself, unless with --condition off')
    name = options.camera_topic or found.name
    if not conditioned and found.encoding != _DETECTABLE:
        raise ValueError(
            f'{name}: its frames are {found.encoding}, and detectors take {_DETECTABLE}: leave '
            'out --condition off')
    if not conditioned and found.blank:
        raise ValueError(
            f'{name}: {found.blank} has a pixel that is not a finite number up to 1e9, and '
            'detectors take none: set --condition on')
    if conditioned and min(found.rows, found.cols) < _LEAST:
        raise ValueError(
            f'{name}: its frames have {found.cols} x {found.rows} pixels, and a conditioner takes '
            f'at least {_LEAST} x {_LEAST}: stack the lines of several frames into one')
    return conditioned
