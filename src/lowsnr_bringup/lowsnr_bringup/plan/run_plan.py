"""
From the options of a run to its nodes and their parameters: all checked, nothing started.

:func:`plan_run` is the only place where the values of options, files and ``--set`` meet.
"""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
import re

from lowsnr_bringup.plan import graph
from lowsnr_bringup.plan.config_files import load_config
from lowsnr_bringup.plan.config_files import load_overrides
from lowsnr_bringup.plan.graph import Values
from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_bringup.plan.sources import find_source
from lowsnr_bringup.plan.sources import Look
from lowsnr_bringup.plan.sources import MATCHED
from lowsnr_bringup.plan.sources import Source
from lowsnr_detect.calibration.operating_point import known_curve
from lowsnr_detect.parts.detector import Detector
from lowsnr_detect.parts.detector import refuse_late_answers
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


def plan_run(options: RunOptions, config_folder: Path, look: Look | None = None) -> RunPlan:
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
    source = find_source(options, config_folder, given, look)
    nodes = graph.run_nodes(
        detectors, source.node, camera=source.camera, conditioned=source.conditioned,
        recorded=options.record is not None, viewed=options.view)
    parameters = graph.parameters(
        nodes,  # from the weakest layer to the strongest
        source.defaults,  # SNR and frame size of the scenario
        files,  # config/*.yaml
        source.facts,  # what the frames are, whatever the files state
        options.parameters(),  # --snr, --seed, --rate ...
        graph.wiring(nodes, detectors, source.name),  # how many subscribers each node has
        overrides)  # --set
    built = _build_detectors(nodes, parameters)
    notes = source.notes + _start_at_once(source, built, parameters, overrides)
    _fill_in(source, nodes, parameters, built)
    _check(nodes, parameters)
    # A bag may give its scenario any name; the results stay in their folder.
    name = '-'.join([re.sub(r'[^\w.-]+', '_', source.name), *detectors])
    return RunPlan(
        name, nodes, parameters, built, notes,
        not _frames(source, parameters) if options.respawn is None else options.respawn)


def _check(nodes: Sequence[graph.Node], parameters: Mapping[str, Values]) -> None:
    """Check the parameters of every node; ValueError names the node."""
    for node in nodes:
        for cls in graph.settings_classes(node.name):
            graph.build(cls, parameters[node.path], node.label)


def _build_detectors(
    nodes: Sequence[graph.Node], parameters: Mapping[str, Values],
) -> dict[str, Detector]:
    built: dict[str, Detector] = {}
    for node in nodes:
        if node.detector:
            *_, cls = graph.settings_classes(node.name)
            built[node.path] = graph.build(cls, parameters[node.path], node.label)
            refuse_late_answers(built[node.path])
    return built


def _start_at_once(
    source: Source, detectors: Mapping[str, Detector], parameters: Mapping[str, Values],
    overrides: graph.Layer,
) -> tuple[str, ...]:
    """
    Make matched detectors of a camera nominal if they would have to be calibrated first.

    A camera waits for no simulation, unless ``--set`` asks for it.  Return a line for each.
    """
    notes = []
    for path, detector in detectors.items() if source.camera else ():
        values, node = parameters[path], path.rpartition('/')[2]
        shape = (values['rows'], values['cols'])
        if (values.get('operating_point', MATCHED) == MATCHED
                and 'operating_point' not in overrides.get(node, ())
                and known_curve(detector, shape) is None):
            values['operating_point'] = 'nominal'
            name = node.removesuffix('_detector')
            notes.append(
                f'{name} is not calibrated for frames of {shape[1]} x {shape[0]} cells: it starts '
                'with its nominal threshold, whose false-alarm rate is not known: --detector auto '
                f'needs no calibration; python scripts/calibrate.py --detector {name} --snr '
                f'{detector.sensor.snr_db:g} --rows {shape[0]} --cols {shape[1]} makes one for '
                'later starts')
    return tuple(notes)


def _fill_in(
    source: Source, nodes: Sequence[graph.Node], parameters: Mapping[str, Values],
    detectors: Mapping[str, Detector],
) -> None:
    """Set what follows from the parameters of other nodes, unless a layer has set it."""
    evaluator = parameters['/evaluator']
    evaluator['expected_frames'] = _frames(source, parameters)
    evaluator.setdefault('operating_points', [
        parameters[path].get('operating_point', 'matched') for path in detectors])
    frames_per = {
        path.rpartition('/')[0]: each.frames_per_declaration for path, each in detectors.items()}
    for node in nodes:
        values = parameters[node.path]
        if node.name == 'tracker':
            values.setdefault('frames_per_detection', frames_per[node.namespace])
        elif node.source:  # only a frame that the evaluator gives up is not waited for
            values.setdefault(
                'patience_s', evaluator.get('answer_within_s', 10.0) + _PATIENCE_BEYOND_S)


def _frames(source: Source, parameters: Mapping[str, Values]) -> int:
    """Return the number of frames of a run, 0 for one without end."""
    values = parameters.get(f'/{source.node}', {})
    if not source.node or values.get('loop'):
        return 0
    frames = int(values.get('frames') or source.frames)
    return min(frames, source.frames) if source.node == 'player' else frames
