"""From the options of a run to nodes and parameters, all checked, nothing started."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence
from dataclasses import dataclass
import difflib
from pathlib import Path
import re
from typing import Any

from lowsnr_bringup.bags.recorded_run import inspect_bag
from lowsnr_bringup.bags.recorded_run import RecordedRun
from lowsnr_bringup.bags.writer import check_new
from lowsnr_bringup.plan import graph
from lowsnr_bringup.plan.config_files import load_config
from lowsnr_bringup.plan.config_files import parse_override
from lowsnr_bringup.plan.run_options import camera_topic
from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_bringup.plan.sources import bag_source
from lowsnr_bringup.plan.sources import camera_source
from lowsnr_bringup.plan.sources import scenario_source
from lowsnr_bringup.plan.sources import Source
from lowsnr_detect.parts.detector import refuse_late_answers
from lowsnr_detect.parts.registry import detector_class
from lowsnr_sensor.scenario import load_scenario

# Readers of a detector's answers: tracker and evaluator; of ``scored``: sensor, where there is
# one, and bring-up.
# A frame's readers are the detectors and the evaluator.  A viewer reads a chain's frames and
# answers.
_DETECTION_READERS = 2
_SCORED_READERS = 1
_DETECTABLE = '32FC1'
_PATIENCE_BEYOND_S = 5.0
Layer = dict[str, dict[str, Any]]


@dataclass(frozen=True)
class RunPlan:
    """
    All that a run needs.

    ``parameters`` are by full node name, ``detectors`` the detector instances with their
    settings by full node name, ``frames`` is None for a run without end, ``notes`` say what is
    wrong with the bag that is replayed, ``respawn`` whether nodes that die are started again.
    """

    name: str
    nodes: list[graph.Node]
    parameters: Layer
    detectors: dict[str, Any]
    frames: int | None
    notes: tuple[str, ...] = ()
    respawn: bool = False

    @property
    def frame_bytes(self) -> int:
        """Size of a frame on the wire, 0 where it is not known."""
        values = self.parameters[next(iter(self.detectors))]
        return 4 * values.get('rows', 0) * values.get('cols', 0)


def plan_run(
    options: RunOptions, config_folder: Path, look: Callable[[str], RecordedRun] | None = None,
) -> RunPlan:
    """
    Check configuration and options, and plan the run.

    Parameters
    ----------
    options
        What the user said.
    config_folder
        Folder with the parameter files and ``scenarios/``.
    look
        Called with the topic of a camera, says what it shows; a run on a camera needs it.

    Raises
    ------
    ValueError
        One line that names the culprit and what is allowed.

    """
    names = list(dict.fromkeys(options.detectors))
    for name in names:
        detector_class(name)
    config, overrides = load_config(config_folder), _overrides(options, names)
    recorded = _inspected(options, look)
    conditioned = _conditioned(options, recorded)
    nodes = graph.plan(
        names, 'player' if recorded else 'sensor', recorded=options.record is not None,
        conditioned=conditioned, viewed=options.view, camera=camera_topic(options))
    source = _source(options, recorded, nodes, config, overrides, config_folder)
    layers = (
        source.defaults, config, source.facts, _option_layer(options),
        _graph_layer(nodes, source, names), overrides)
    detectors = _build_all(nodes, graph.parameters(nodes, *layers))
    parameters = graph.parameters(nodes, _tracker_layer(nodes, detectors), *layers)
    parameters['/evaluator']['operating_points'] = [
        parameters[node].get('operating_point', 'matched') for node in detectors]
    # Only what the evaluator itself gives up is not waited for.
    for node in filter(lambda node: node.source, nodes):
        parameters[node.path].setdefault('patience_s', _PATIENCE_BEYOND_S + parameters[
            '/evaluator'].get('answer_within_s', 10.0))
    frames = None if options.endless else options.frames or source.frames
    if recorded is not None and frames is not None:
        frames = min(frames, source.frames)
    # A bag may call its scenario anything; the results stay in their folder.
    name = re.sub(r'[^\w.-]+', '_', source.name)
    return RunPlan(
        '-'.join([name, *names]), nodes, parameters, detectors, frames,
        recorded.notes if recorded else (),
        options.endless if options.respawn is None else options.respawn)


def _inspected(
    options: RunOptions, look: Callable[[str], RecordedRun] | None,
) -> RecordedRun | None:
    """Check where a run is recorded to; look at the camera, or through the bag."""
    if options.record is not None:
        check_new(options.record)
    if topic := camera_topic(options):
        assert look is not None
        return look(topic)
    if options.replay is None:
        return None
    if options.loop:
        raise ValueError('--loop: a bag is replayed once')
    return inspect_bag(options.replay, options.frames_topic, options.truth_topic)


def _conditioned(options: RunOptions, recorded: RecordedRun | None) -> bool:
    """Return whether the frames pass a conditioner."""
    if recorded is None:
        if options.condition == 'on':
            raise ValueError('--condition on: simulated frames are not conditioned')
        return False
    conditioned = recorded.raw if options.condition == 'auto' else options.condition == 'on'
    if conditioned and camera_topic(options) == f'{graph.CONDITIONED}image_raw':
        raise ValueError(
            f'--camera: a run publishes {options.camera} itself, unless with --condition off')
    if not conditioned and recorded.encoding != _DETECTABLE:
        raise ValueError(
            f'{options.frames_from}: its frames are {recorded.encoding}, and detectors take '
            f'{_DETECTABLE}: leave out --condition off')
    return conditioned


def _source(
    options: RunOptions, recorded: RecordedRun | None, nodes: Sequence[graph.Node],
    config: Layer, overrides: Layer, config_folder: Path,
) -> Source:
    if recorded is not None and options.camera is not None:
        return camera_source(camera_topic(options), recorded, nodes, config, overrides)
    if recorded is not None and options.replay is not None:
        return bag_source(
            options.replay, (recorded.frames_topic, options.truth_topic), recorded, nodes, config,
            overrides)
    path = find_scenario(options.scenario, config_folder / 'scenarios')
    sensor = graph.parameters(nodes, config, overrides)['/sensor']
    return scenario_source(path, load_scenario(
        path, sensor.get('sensor.frame_period_s', 1.0), sensor.get('sensor.cell_size_m', 1.0)))


def find_scenario(text: str, folder: Path) -> Path:
    """
    Return the file of a scenario, given by name or path.

    Raises
    ------
    ValueError
        If there is none; names those of the folder.

    """
    named = folder / f'{text}.yaml'
    if named.is_file() or Path(text).is_file():
        return (named if named.is_file() else Path(text)).resolve()
    known = sorted(item.stem for item in folder.glob('*.yaml'))
    near = difflib.get_close_matches(text, known, n=1)
    hint = f'; did you mean {near[0]}?' if near else ''
    raise ValueError(
        f'scenario {text!r} is neither a file nor one of {", ".join(known)}{hint}')


def _overrides(options: RunOptions, detectors: Sequence[str]) -> Layer:
    layer: Layer = {}
    for text in options.overrides:
        name, values = parse_override(text, detectors)
        layer.setdefault(name, {}).update(values)
    return layer


def _option_layer(options: RunOptions) -> Layer:
    every: dict[str, Any] = {'seed': options.seed, 'sensor.snr_db': options.snr_db}
    source = {
        'rate_hz': options.rate_hz, 'frames': options.frames,
        'lockstep': options.lockstep, 'loop': options.loop}
    recorder = {
        'storage': options.storage, 'bag': options.record and str(options.record.resolve())}
    layers: Layer = {
        graph.EVERY_NODE: every, 'sensor': source, 'player': source, 'recorder': recorder}
    return {
        name: {key: value for key, value in values.items() if value is not None}
        for name, values in layers.items()}


def _graph_layer(nodes: Sequence[graph.Node], source: Source, names: list[str]) -> Layer:
    """Return what follows from who is in the graph."""
    present = {node.name for node in nodes}
    viewed = int('viewer' in present)  # one for each chain
    takers = {'consumers': len(names) * (1 + viewed) + 1}
    first = {'consumers': 1} if 'conditioner' in present else takers
    sources = sum(node.source for node in nodes)
    return {
        graph.EVERY_NODE: {'autostart': False, 'observers': int('recorder' in present)},
        'sensor': first, 'player': first, 'conditioner': takers,
        **{f'{name}_detector': {'consumers': _DETECTION_READERS + viewed} for name in names},
        'tracker': {'consumers': 1 + viewed}, 'viewer': {'consumers': 1},
        'evaluator': {
            'consumers': _SCORED_READERS + sources, 'scenario': source.name, 'detectors': names,
            'operating_points': names, 'namespaces': len(names) > 1},
        **{node.path: {'live': True} for node in nodes if node.live},
    }


def _tracker_layer(nodes: Sequence[graph.Node], detectors: dict[str, Any]) -> Layer:
    """Tell each tracker how many frames the declarations of its detector rest on."""
    by_space = {node.namespace: detectors[node.path] for node in nodes if node.path in detectors}
    return {
        node.path: {'frames_per_detection': by_space[node.namespace].frames_per_declaration}
        for node in nodes if node.name == 'tracker'}


def _build_all(nodes: Sequence[graph.Node], parameters: Layer) -> dict[str, Any]:
    """Check every node's settings as a whole; return the detectors by full node name."""
    detectors = {}
    for node in nodes:
        built = [graph.build(cls, parameters[node.path], node.label)
                 for cls in graph.settings_classes(node.name)]
        if node.name.endswith('_detector'):
            detectors[node.path] = built[-1]
            refuse_late_answers(built[-1])
    return detectors
