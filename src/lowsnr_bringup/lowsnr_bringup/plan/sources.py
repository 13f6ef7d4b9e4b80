"""Where the frames of a run come from, and what follows from that for every node."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field
from pathlib import Path
from typing import Any

from lowsnr_bringup.bags.recorded_run import RecordedRun
from lowsnr_bringup.plan import graph
from lowsnr_bringup.plan.cadence import at_cadence
from lowsnr_sensor.conditioning.conditioner import ConditioningSettings
from lowsnr_sensor.scenario import Scenario

Layer = dict[str, dict[str, Any]]
# What a source sends.
_FRAMES, _TRUTH = ('/image_raw', '/clock'), ('/ground_truth', '/ground_truth/odometry')


@dataclass(frozen=True)
class Source:
    """
    The origin of the frames.

    ``frames`` is 0 for one without end, ``defaults`` is what it says of the settings where the
    configuration says nothing, ``facts`` what it says whatever the configuration says.
    """

    name: str
    frames: int
    defaults: Layer = field(default_factory=dict)
    facts: Layer = field(default_factory=dict)


def scenario_source(path: Path, scenario: Scenario) -> Source:
    """Return the source that a simulated sensor is."""
    return Source(
        path.stem, scenario.frames,
        {graph.EVERY_NODE: {
            'sensor.snr_db': scenario.snr_db, 'rows': scenario.rows, 'cols': scenario.cols}},
        {'sensor': {'scenario': str(path)}, 'recorder': {'topics': [*_FRAMES, *_TRUTH]}})


def bag_source(
    path: Path, topics: tuple[str, str], recorded: RecordedRun, nodes: Sequence[graph.Node],
    config: Layer, overrides: Layer,
) -> Source:
    """
    Return the source that a bag is.

    Parameters
    ----------
    path
        The bag.
    topics
        Names of its topics of frames and of truth.
    recorded
        What was found in it.
    nodes
        The nodes of the run.
    config
        The configuration; unless a simulation was recorded, its settings of motion hold for the
        frames of the bag, whatever time lies between them.
    overrides
        What the user says beside it.

    """
    player = {
        'bag': str(path.resolve()), 'simulated': recorded.simulated, 'frames_topic': topics[0],
        'truth_topic': topics[1] if recorded.truth else ''}
    sent = [*_FRAMES, *(_TRUTH if recorded.truth else ())]
    return _source(recorded, sent, player, nodes, config, overrides)


def camera_source(
    topic: str, shown: RecordedRun, nodes: Sequence[graph.Node], config: Layer, overrides: Layer,
) -> Source:
    """Return the source that a camera is; as :func:`bag_source`, of what it was seen to show."""
    return _source(shown, [topic], {}, nodes, config, overrides)


def _source(
    recorded: RecordedRun, sent: Sequence[str], player: dict[str, Any],
    nodes: Sequence[graph.Node], config: Layer, overrides: Layer,
) -> Source:
    every: dict[str, Any] = {
        'rows': recorded.rows, 'cols': recorded.cols, 'truth': recorded.truth,
        **(recorded.sensor or {'sensor.frame_period_s': recorded.period_s})}
    if recorded.seed is not None:
        every['seed'] = recorded.seed
    whole = {'rows': recorded.rows, 'cols': recorded.cols}
    facts: Layer = {
        graph.EVERY_NODE: every, 'recorder': whole | {'topics': list(sent)},
        'player': whole | player}
    given = graph.parameters(nodes, config, overrides)
    if '/conditioner' in given:
        conditioning = graph.build(ConditioningSettings, given['/conditioner'], 'conditioner')
        rows, cols = conditioning.size((recorded.rows, recorded.cols))
        every |= {'rows': rows, 'cols': cols, 'sensor.noise_std': 1.0}
    if not recorded.simulated:
        facts |= _cadence_layer(
            nodes, graph.parameters(nodes, config), recorded.period_s)
    return Source(recorded.name, recorded.frames, facts=facts)


def _cadence_layer(nodes: Sequence[graph.Node], given: Layer, period_s: float) -> Layer:
    return {
        node.path: {
            name: value for cls in graph.settings_classes(node.name)
            for name, value in at_cadence(cls, given[node.path], period_s).items()}
        for node in nodes}
