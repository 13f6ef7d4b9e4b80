# SPDX-License-Identifier: Apache-2.0
"""Scoring of one frame: what each chain declared against the objects that are present."""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Truth
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_eval.scoring import metrics
import numpy as np

LEVELS = ('detection', 'tracking')


@dataclass(frozen=True)
class Answer:
    """
    What a chain answered to one frame; None for what it did not answer.

    ``latency_ms`` is the wall time from the frame to its tracks, ``detection_ms`` that to its
    detections.
    """

    detections: Sequence[Estimate] | None = None
    tracks: Sequence[Estimate] | None = None
    latency_ms: float | None = None
    detection_ms: float | None = None


class Comparison(NamedTuple):
    """
    How the estimates of one frame compare with the objects present in it.

    ``declared`` counts the estimates, ``hit_ids`` are the ids of the objects that were hit.
    ``rmse_position_m`` is taken over the hits, ``rmse_velocity_mps`` over the ``velocities`` hits
    whose velocity was estimated; both are None where there is no such hit.  Without truth there
    is no hit, and false alarms and GOSPA are None.
    """

    declared: int
    hit_ids: tuple[str, ...] = ()
    false_alarms: int | None = None
    rmse_position_m: float | None = None
    rmse_velocity_mps: float | None = None
    gospa_m: float | None = None
    velocities: int = 0


class FrameScore(NamedTuple):
    """
    The score of one chain at one level in one frame.

    ``object_ids`` is None where the truth is unknown, ``comparison`` where the chain did not
    answer.
    """

    frame: int
    stamp_s: float
    detector: str
    level: str
    object_ids: tuple[str, ...] | None
    comparison: Comparison | None


def score_frame(
    frame: int, stamp_s: float, truth: Sequence[Truth] | None, answers: Mapping[str, Answer],
    evaluation: Evaluation,
) -> list[FrameScore]:
    """
    Score one frame.

    Parameters
    ----------
    frame
        Number of the frame, from 1.
    stamp_s
        Its time [s].
    truth
        Objects present in it, None where they are unknown.
    answers
        The answer of each chain by the name of its detector.
    evaluation
        Gate and cutoff.

    Returns
    -------
    list of FrameScore
        One for each chain and level, in the order of the answers.

    """
    ids = None if truth is None else tuple(item.id for item in truth)
    return [
        FrameScore(frame, stamp_s, detector, level, ids,
                   None if estimates is None else compare(truth, estimates, evaluation))
        for detector, answer in answers.items()
        for level, estimates in zip(LEVELS, (answer.detections, answer.tracks))]


def compare(
    truth: Sequence[Truth] | None, estimates: Sequence[Estimate], evaluation: Evaluation,
) -> Comparison:
    """
    Compare the estimates of one frame with the objects present in it, where they are known.

    At most one estimate hits an object, and an estimate hits at most one object.  A second
    estimate within the gate of an object is neither a hit nor a false alarm.
    """
    if truth is None:
        return Comparison(len(estimates))
    true, found = _states(truth), _states(estimates)
    distance = metrics.distances(true[:, POS], found[:, POS])
    rows, columns = metrics.match_within_gate(distance, evaluation.gate_m)
    error = found[columns] - true[rows]
    velocity = np.hypot(*error[:, VEL].T)
    velocity = velocity[np.isfinite(velocity)]
    return Comparison(
        declared=len(estimates),
        hit_ids=tuple(truth[row].id for row in rows),
        false_alarms=metrics.count_false_alarms(distance, evaluation.gate_m),
        rmse_position_m=metrics.root_mean_square(np.hypot(*error[:, POS].T)),
        rmse_velocity_mps=metrics.root_mean_square(velocity),
        gospa_m=metrics.gospa(distance, evaluation.gospa_cutoff_m),
        velocities=velocity.size,
    )


def _states(items: Sequence[Truth] | Sequence[Estimate]) -> np.ndarray:
    """Return the states of records, (n, 4)."""
    return np.array([item.state for item in items], dtype=float).reshape(-1, 4)
