"""Scoring of one frame: what a chain declared against the objects that are there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Truth
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_eval.scoring.metrics import count_false_alarms
from lowsnr_eval.scoring.metrics import distances
from lowsnr_eval.scoring.metrics import gospa
from lowsnr_eval.scoring.metrics import match_within_gate
from lowsnr_eval.scoring.metrics import root_mean_square
import numpy as np


@dataclass(frozen=True)
class Answer:
    """
    What a chain answered to one frame; None for what it did not answer.

    ``latency_ms`` is the wall time from the frame to the end of the chain, of which
    ``detection_ms`` had passed when the detections came.
    """

    detections: Sequence[Estimate] | None = None
    tracks: Sequence[Estimate] | None = None
    latency_ms: float | None = None
    detection_ms: float | None = None


@dataclass(frozen=True)
class Outcome:
    """
    How an answer compares with the truth of its frame.

    ``declared`` counts the estimates, ``hit`` has the ids of the objects that were hit, in
    the order of ``position_errors_m``, (hits,) [m].  ``velocity_errors_mps`` holds only those
    hits whose velocity was estimated [m/s].  Without truth there is no hit, and neither false
    alarms nor GOSPA.
    """

    declared: int
    hit: tuple[str, ...]
    false_alarms: int | None
    position_errors_m: np.ndarray
    velocity_errors_mps: np.ndarray
    gospa_m: float | None

    @property
    def rmse_position_m(self) -> float | None:
        """Root mean square over the hits of the frame [m]; None of none."""
        return root_mean_square(self.position_errors_m)

    @property
    def rmse_velocity_mps(self) -> float | None:
        """Root mean square over the hits with a velocity [m/s]; None of none."""
        return root_mean_square(self.velocity_errors_mps)


@dataclass(frozen=True)
class FrameScore:
    """
    One chain at one level in one frame.

    ``outcome`` is None where it did not answer, ``objects`` where the truth is not known.
    """

    frame: int
    stamp_s: float
    detector: str
    level: str
    objects: tuple[str, ...] | None
    outcome: Outcome | None


def compare(
    truth: Sequence[Truth] | None, estimates: Sequence[Estimate], evaluation: Evaluation,
) -> Outcome:
    """
    Compare the estimates of one frame with the objects present in it, where they are known.

    Each object is hit by at most one estimate and each estimate hits at most one object.
    A further estimate within the gate of an object is no hit, but no false alarm either.
    """
    if truth is None:
        return Outcome(len(estimates), (), None, np.empty(0), np.empty(0), None)
    true, found = _states(truth), _states(estimates)
    distance = distances(true[:, POS], found[:, POS])
    rows, columns = match_within_gate(distance, evaluation.gate_m)
    error = found[columns] - true[rows]
    velocity = np.hypot(*error[:, VEL].T)
    return Outcome(
        declared=len(estimates),
        hit=tuple(truth[row].id for row in rows),
        false_alarms=count_false_alarms(distance, evaluation.gate_m),
        position_errors_m=np.hypot(*error[:, POS].T),
        velocity_errors_mps=velocity[np.isfinite(velocity)],
        gospa_m=gospa(distance, evaluation.gospa_cutoff_m),
    )


def _states(items: Sequence[Truth] | Sequence[Estimate]) -> np.ndarray:
    """Return the states of records, (n, 4)."""
    return np.array([item.state for item in items], dtype=float).reshape(-1, 4)
