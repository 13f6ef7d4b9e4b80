"""From the options of a run to nodes and parameters, all checked, nothing started."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import difflib
from pathlib import Path
from typing import Any

from lowsnr_detect.detector import refuse_late_answers
from lowsnr_detect.registry import detector_class
from lowsnr_eval import graph
from lowsnr_sensor.scenario import load_scenario
from lowsnr_sensor.scenario import Scenario

# Readers of a detector's answers: tracker and evaluator; of ``scored``: sensor and bring-up.
_DETECTION_READERS = 2
_SCORED_READERS = 2
Layer = dict[str, dict[str, Any]]


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """What a user says of a run; None where the configuration decides."""

    detectors: Sequence[str]
    scenario: str
    snr_db: float | None = None
    frames: int | None = None
    seed: int | None = None
    rate_hz: float | None = None
    lockstep: bool = False
    loop: bool = False
    overrides: Sequence[str] = ()


@dataclass(frozen=True)
class RunPlan:
    """
    All that a run needs.

    ``parameters`` are by full node name, ``detectors`` the detector instances with their
    settings by full node name, ``frames`` is None for a run without end.
    """

    name: str
    nodes: list[graph.Node]
    parameters: Layer
    detectors: dict[str, Any]
    frames: int | None


def plan_run(options: RunOptions, config_folder: Path) -> RunPlan:
    """
    Check configuration and options, and plan the run.

    Parameters
    ----------
    options
        What the user said.
    config_folder
        Folder with the parameter files and ``scenarios/``.

    Raises
    ------
    ValueError
        One line that names the culprit and what is allowed.

    """
    names = list(dict.fromkeys(options.detectors))
    for name in names:
        detector_class(name)
    nodes = graph.plan(names)
    config, overrides = graph.load_config(config_folder), _overrides(options, names)
    path = find_scenario(options.scenario, config_folder / 'scenarios')
    sensor = graph.parameters(nodes, config, overrides)['/sensor']
    scenario = load_scenario(
        path, sensor.get('sensor.frame_period_s', 1.0), sensor.get('sensor.cell_size_m', 1.0))
    layers = (
        _scenario_layer(scenario), config, _option_layer(options), _graph_layer(path, names),
        overrides)
    detectors = _build_all(nodes, graph.parameters(nodes, *layers))
    parameters = graph.parameters(nodes, _tracker_layer(nodes, detectors), *layers)
    parameters['/evaluator']['operating_points'] = [
        parameters[node].get('operating_point', 'matched') for node in detectors]
    frames = None if options.loop else options.frames or scenario.frames
    return RunPlan('-'.join([path.stem, *names]), nodes, parameters, detectors, frames)


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
        name, values = graph.parse_override(text, detectors)
        layer.setdefault(name, {}).update(values)
    return layer


def _scenario_layer(scenario: Scenario) -> Layer:
    """Return what the scenario says of the frames; the configuration may say otherwise."""
    return {graph.EVERY_NODE: {
        'sensor.snr_db': scenario.snr_db, 'rows': scenario.rows, 'cols': scenario.cols}}


def _option_layer(options: RunOptions) -> Layer:
    every = {'seed': options.seed, 'sensor.snr_db': options.snr_db}
    sensor = {
        'rate_hz': options.rate_hz, 'frames': options.frames,
        'lockstep': options.lockstep, 'loop': options.loop}
    return {
        name: {key: value for key, value in values.items() if value is not None}
        for name, values in ((graph.EVERY_NODE, every), ('sensor', sensor))}


def _graph_layer(scenario: Path, names: list[str]) -> Layer:
    """Return what follows from who is in the graph."""
    return {
        graph.EVERY_NODE: {'autostart': False},
        'sensor': {'scenario': str(scenario), 'consumers': len(names)},
        **{f'{name}_detector': {'consumers': _DETECTION_READERS} for name in names},
        'tracker': {'consumers': 1},
        'evaluator': {
            'consumers': _SCORED_READERS, 'scenario': scenario.stem, 'detectors': names,
            'operating_points': names, 'namespaces': len(names) > 1},
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
