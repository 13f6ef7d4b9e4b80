# SPDX-License-Identifier: Apache-2.0
"""
From the options of a run to its nodes and their parameters: all checked, nothing started.

:func:`plan_run` is the only place where the values of options, files and ``--set`` meet.
"""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
import math
from pathlib import Path
import re

from lowsnr_bringup.plan import graph
from lowsnr_bringup.plan.config_files import load_config
from lowsnr_bringup.plan.config_files import load_overrides
from lowsnr_bringup.plan.frame_checks import check_destinations
from lowsnr_bringup.plan.frame_checks import check_detector
from lowsnr_bringup.plan.graph import Values
from lowsnr_bringup.plan.recorded_frames import RecordedRun
from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_bringup.plan.sources import find_source
from lowsnr_bringup.plan.sources import Look
from lowsnr_bringup.plan.sources import Source
from lowsnr_bringup.plan.start_notes import blurred
from lowsnr_bringup.plan.start_notes import start_at_once
from lowsnr_bringup.plan.start_notes import too_fast
from lowsnr_bringup.plan.wiring import divide
from lowsnr_bringup.plan.wiring import wiring
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_detect.grid.fixed_lag import lag_of
from lowsnr_detect.parts.cell_detector import resolution_of
from lowsnr_detect.parts.detector import Detector
from lowsnr_detect.parts.registry import detector_class

# A source in lockstep waits this much longer for a frame than the evaluator does [s].
_PATIENCE_BEYOND_S = 5.0


@dataclass(frozen=True)
class RunPlan:
    """A run, checked and ready to start."""

    name: str  # fit for a folder
    nodes: list[graph.Node]  # subscribers before publishers
    parameters: dict[str, Values]  # of every node, by its full name
    detectors: dict[str, Detector]  # by the full name of their nodes
    notes: tuple[str, ...] = ()  # what the user should know before it starts, one line each
    respawn: bool = False  # whether nodes that die are started again

    @property
    def frames(self) -> int | None:
        """Return the number of frames of the run, None for one without end."""
        return self.parameters['/evaluator']['expected_frames'] or None

    @property
    def frame_bytes(self) -> int:
        """Size of a frame as the detectors receive it, 0 where it is not known."""
        values = self.parameters[next(iter(self.detectors))]
        return 4 * int(values.get('rows', 0)) * int(values.get('cols', 0))


def plan_run(
    options: RunOptions, config_folder: Path, look: Look | None = None,
    array: RecordedRun | None = None,
) -> RunPlan:
    """
    Check configuration and options, and plan the run.

    Parameters
    ----------
    options
        The options.
    config_folder
        Folder with the parameter files and ``scenarios/``.
    look
        Returns what the camera on a topic shows; only a run with a camera needs it.
    array
        The frames of an array, which take the place of those that the options name.

    Raises
    ------
    ValueError
        One line that names the culprit and what is allowed.

    """
    detectors = list(dict.fromkeys(options.detectors))
    for name in detectors:
        detector_class(name)
    files, overrides = load_config(config_folder), load_overrides(options.overrides, detectors)
    if options.record is not None:
        from lowsnr_bringup.bags.writer import check_new  # slow to import
        check_new(options.record)
    given = partial(graph.merged, layers=(files, overrides))
    source = find_source(options, config_folder, given, look, array)
    nodes = _nodes(options, detectors, source)
    parameters = graph.parameters(
        nodes,  # from the weakest layer to the strongest
        source.defaults,  # SNR and frame size of the scenario
        files,  # config/*.yaml
        source.facts,  # what the frames are, whatever the files state
        options.parameters(),  # --snr, --seed, --rate ...
        wiring(nodes, detectors, source.name),  # how many subscribers each node has
        overrides)  # --set
    built = _build_detectors(nodes, parameters)
    notes = (*source.notes, *start_at_once(source, built, parameters, overrides),
             *too_fast(source, built, nodes, parameters), *blurred(built))
    divide(nodes, parameters, built, options.tiles)
    _fill_in(source, nodes, parameters, built)
    _check(nodes, parameters)
    # A bag may give its scenario any name; the results stay in their folder.
    name = '-'.join([re.sub(r'[^\w.-]+', '_', source.name), *detectors])
    return RunPlan(
        name, nodes, parameters, built, notes,
        not _frames(source, parameters) if options.respawn is None else options.respawn)


def _nodes(
    options: RunOptions, detectors: Sequence[str], source: Source,
) -> list[graph.Node]:
    return graph.run_nodes(
        detectors, source.node, camera=source.camera, conditioned=source.conditioned,
        recorded=options.record is not None, viewed=options.view, composed=options.composed,
        tiles=math.prod(options.tiles))


def _check(nodes: Sequence[graph.Node], parameters: Mapping[str, Values]) -> None:
    """Check the parameters of every node; ValueError names the node."""
    for node in nodes:
        values = parameters[node.path]
        for cls in graph.settings_classes(node.section):
            check_destinations(node.label, graph.build(cls, values, node.label), (
                values.get('rows', 0), values.get('cols', 0)))


def _build_detectors(
    nodes: Sequence[graph.Node], parameters: Mapping[str, Values],
) -> dict[str, Detector]:
    built: dict[str, Detector] = {}
    for node in nodes:
        if node.detector:
            *_, cls = graph.settings_classes(node.section)
            values = parameters[node.path]
            built[node.path] = graph.build(cls, values, node.label)
            check_detector(node.label, built[node.path], values)
    return built


def _fill_in(
    source: Source, nodes: Sequence[graph.Node], parameters: Mapping[str, Values],
    detectors: Mapping[str, Detector],
) -> None:
    """Set what follows from the parameters of other nodes, unless a layer has set it."""
    evaluator = parameters['/evaluator']
    evaluator['expected_frames'] = _frames(source, parameters)
    evaluator.setdefault('operating_points', [
        parameters[path].get('operating_point', 'matched') for path in detectors])
    asked = [parameters[f'{path.rpartition("/")[0]}/tracker'].get('life.false_tracks', 0.0)
             for path in detectors]
    if any(asked):
        evaluator['false_tracks'] = asked
    evaluator['lags'] = lags = [lag_of(each) for each in detectors.values()]
    of_space = {path.rpartition('/')[0]: each for path, each in detectors.items()}
    chains = {path.rpartition('/')[0]: (path.rpartition('/')[2].removesuffix('_detector'), n)
              for n, path in enumerate(detectors)}
    maps = [path for path in detectors if parameters[path].get('statistic_map')]
    evaluator['statistic_maps'] = tuple(chains[path.rpartition('/')[0]][0] for path in maps)
    for node in nodes:
        values = parameters[node.path]
        if node.name == 'tracker':
            detector = of_space[node.namespace]
            values.setdefault('frames_per_detection', detector.frames_per_declaration)
            values.setdefault('detection.resolution', resolution_of(detector))
        elif node.name == 'viewer':
            values['lag'] = lag_of(of_space[node.namespace])
            (name, number), snr_db = chains[node.namespace], of_space[node.namespace].sensor.snr_db
            values['statistic_map'] = name in evaluator['statistic_maps']
            title = f'{source.name}, expected SNR {snr_db:g} dB: {name}'
            _fill_in_page(values, evaluator, title, number)
        elif node.source:  # only a frame that the evaluator gives up is not waited for
            answered_s = evaluator.get('answer_within_s', RunSettings.answer_within_s)
            values.setdefault('patience_s', answered_s + _PATIENCE_BEYOND_S)
            values['lag'] = max(lags)


def _fill_in_page(values: Values, evaluator: Values, title: str, number: int) -> None:
    """Set what the live page of a viewer shows; of several the browser opens the first."""
    known: Values = {key: evaluator[key] for key in ('pixels', 'gate_cells') if key in evaluator}
    for key, value in {'title': title, **known}.items():
        values.setdefault(key, value)
    values['page_port'] += number * bool(values['page_port'])
    values['browser'] = values['browser'] and not number


def _frames(source: Source, parameters: Mapping[str, Values]) -> int:
    """Return the number of frames of a run, 0 for one without end."""
    values = parameters.get(f'/{source.node}', {})
    if not source.node or values.get('loop'):
        return 0
    frames = int(values.get('frames') or source.frames)
    return min(frames, source.frames) if source.node == 'player' else frames
