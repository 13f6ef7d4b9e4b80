# SPDX-License-Identifier: Apache-2.0
"""The chains that a bag holds, and how they are scored."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field
from dataclasses import replace
from typing import Any

from lowsnr_bringup.bags.bag_frames import check_type
from lowsnr_bringup.bags.bag_frames import IMAGE
from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.recorded_run import ARRAY
from lowsnr_bringup.bags.recorded_run import CAMERA_INFO
from lowsnr_bringup.bags.recorded_run import recorded_frames_topic
from lowsnr_bringup.bags.recorded_run import recorded_parameters
from lowsnr_bringup.plan import graph
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import NodeSettings
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_common.settings.text import cell_text
from lowsnr_common.settings.text import one_line
from lowsnr_eval.scoring.run_scoring import STATISTIC
from lowsnr_eval.scoring.run_scoring import TRUTH

_LEVELS = ('detections', 'tracks')
_MAPS = f'{graph.CONDITIONED}camera_info'
_CELLS = {_MAPS: CAMERA_INFO, f'{graph.CONDITIONED}image_raw': IMAGE}


@dataclass(frozen=True)
class RecordedChains:
    """
    What is scored of a bag.

    ``names`` maps each topic of the bag to its name in scoring.  The bag may lack the
    ``frames_topic``.  ``cells_topics`` are those of the maps of conditioned frames, if any, and of
    these frames, if the bag has them too.  ``statistics`` maps the topics of statistics that the
    bag has to the names of their chains.
    """

    run: RunSettings
    evaluation: Evaluation
    seed: int
    names: Mapping[str, str]
    frames_topic: str
    cells_topics: tuple[str, ...] = ()
    statistics: Mapping[str, str] = field(default_factory=dict)


def find_chains(
    bag: Bag, config: Mapping[str, Mapping[str, Any]],
    frames_topic: str | None = None, truth_topic: str | None = None,
) -> RecordedChains:
    """
    Find what can be scored in a bag.

    Parameters
    ----------
    bag
        The bag, open.
    config
        The configuration, for a bag that does not hold the parameters of its run.
    frames_topic, truth_topic
        Their names in the bag; None for those of the recorded run.

    Raises
    ------
    ValueError
        One line, if the bag has neither detections nor tracks, or not the truth asked for.

    """
    told = recorded_parameters(bag)
    evaluator = told.get('/evaluator', {})
    for cls in (NodeSettings, RunSettings):
        graph.build(cls, evaluator, f'{bag.path}: evaluator')
    names = _names(bag, {
        f'/{name}' if evaluator.get('namespaces') else '': name
        for name in evaluator.get('detectors', ())})
    if truth_topic is not None:
        check_type(bag, truth_topic, (ARRAY,), '--truth-topic')
    truth_topic = truth_topic or f'/{TRUTH}'
    truth = bag.topics.get(truth_topic) == ARRAY
    if not truth and not any(bag.topics.get(f'{space}/{_LEVELS[0]}') == ARRAY for space in names):
        raise ValueError(f'{bag.path}: has neither truth nor detections')
    run, evaluation = _settings(bag, config, evaluator, names, truth)
    statistics = {f'{space}/{STATISTIC}': name for space, name in names.items()
                  if bag.topics.get(f'{space}/{STATISTIC}') == IMAGE}
    topics = {f'{space}/{level}': f'{name}/{level}' if len(names) > 1 else level
              for space, name in names.items() for level in _LEVELS}
    if truth:
        topics[truth_topic] = TRUTH
    return RecordedChains(
        replace(run, statistic_maps=tuple(statistics.values())), evaluation,
        evaluator.get('seed', 0),
        {own: topic for own, topic in topics.items() if bag.topics.get(own) == ARRAY},
        frames_topic or recorded_frames_topic(bag, told),
        _cells_topics(bag), statistics)


def _cells_topics(bag: Bag) -> tuple[str, ...]:
    found = tuple(own for own, kind in _CELLS.items() if bag.topics.get(own) == kind)
    return found if _MAPS in found else ()


def _names(bag: Bag, known: Mapping[str, str]) -> dict[str, str]:
    """
    Return a name in one line for the chain of each namespace, no two alike.

    The chains of the recorded run come first, with its names and in its order.
    """
    spaces = {
        name.removesuffix(f'/{level}') for name, kind in bag.topics.items() for level in _LEVELS
        if kind == ARRAY and name.endswith(f'/{level}')}
    if not spaces:
        raise ValueError(f'{bag.path}: has neither detections nor tracks of type {ARRAY}')
    order = [space for space in known if space in spaces]
    names: dict[str, str] = {}
    for space in order + sorted(spaces.difference(order)):
        wanted = name = cell_text(one_line(
            known.get(space) or space.strip('/').replace('/', '.'))) or 'recorded'
        while name in names.values():
            name = f'{wanted}-{len(names) + 1}'
        names[space] = name
    return names


def _settings(
    bag: Bag, config: Mapping[str, Mapping[str, Any]], evaluator: Mapping[str, Any],
    names: Mapping[str, str], truth: bool,
) -> tuple[RunSettings, Evaluation]:
    node = graph.Node('evaluator', '')
    points, lags = (
        dict(zip(evaluator.get('detectors', ()), evaluator.get(key, ())))
        for key in ('operating_points', 'lags'))
    values = graph.parameters([node], config)[node.path] | dict(evaluator) | {
        'truth': truth, 'namespaces': len(names) > 1,
        'scenario': one_line(evaluator.get('scenario') or bag.path.resolve().stem),
        'detectors': list(names.values()),
        'operating_points': [points.get(name, 'unknown') for name in names.values()],
        'lags': [lags.get(name, 0) for name in names.values()]}
    label = f'{bag.path}: evaluator'
    return (graph.build(RunSettings, values, label), graph.build(Evaluation, values, label))
