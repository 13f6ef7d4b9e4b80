"""
Scores of many runs at once, for at most one object, as in the paper.

The figures are those of :func:`lowsnr_eval.scoring.frame_scoring.compare`; with one object no
assignment problem is left, so that all frames of all runs are scored together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import fields

from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_common.settings.node_settings import Evaluation
import numpy as np


@dataclass(frozen=True)
class RunScores:
    """
    What was declared in every frame of every run, and how good it was.

    Parameters
    ----------
    present : (runs, frames) ndarray of bool
        Whether the object is there.
    declared : (runs, frames) ndarray of int
        Number of estimates.
    hit : (runs, frames) ndarray of bool
        Whether one of them hits the object.
    false_alarms : (runs, frames) ndarray of int
        Estimates that lie within the gate of no object.
    position_error_m : (runs, frames) ndarray
        Distance of the hit from the object [m], NaN without a hit.
    velocity_error_mps : (runs, frames) ndarray
        Error of its velocity [m/s], NaN without a hit or a velocity.
    gospa_m : (runs, frames) ndarray
        GOSPA [m].

    """

    present: np.ndarray
    declared: np.ndarray
    hit: np.ndarray
    false_alarms: np.ndarray
    position_error_m: np.ndarray
    velocity_error_mps: np.ndarray
    gospa_m: np.ndarray

    def __len__(self) -> int:
        """Return the number of runs."""
        return len(self.present)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays by name."""
        return {item.name: getattr(self, item.name) for item in fields(self)}

    @classmethod
    def join(cls, parts: Sequence[RunScores]) -> RunScores:
        """Return the runs of all parts, one after the other."""
        return cls(**{
            item.name: np.concatenate([getattr(part, item.name) for part in parts])
            for item in fields(cls)})


def score_runs(truth: np.ndarray, states: np.ndarray, evaluation: Evaluation) -> RunScores:
    """
    Score the estimates of every frame of every run.

    Parameters
    ----------
    truth : (runs, frames, 4) ndarray
        State of the object [m, m/s], NaN in frames without it.
    states : (runs, frames, D, 4) ndarray
        Estimates, NaN in slots that are not used; the velocity is NaN where not estimated.
    evaluation
        Gate and cutoff.

    """
    used = np.isfinite(states[..., POS]).all(axis=-1)
    present = np.isfinite(truth[..., POS]).all(axis=-1)
    error = states - truth[..., None, :]
    distance = np.hypot(error[..., POS[0]], error[..., POS[1]])
    distance = np.where(used & present[..., None], distance, np.inf)
    declared = used.sum(axis=-1)
    nearest, error = _nearest(distance, error)
    hit = nearest <= evaluation.gate_m
    cutoff = evaluation.gospa_cutoff_m
    paired = np.minimum(nearest, cutoff) ** 2 * (present & (declared > 0))
    unpaired = cutoff**2 / 2.0 * abs(declared - present)
    return RunScores(
        present=present, declared=declared.astype(np.int32), hit=hit,
        false_alarms=np.asarray(
            np.sum(used & (distance > evaluation.gate_m), axis=-1), dtype=np.int32),
        position_error_m=np.where(hit, nearest, np.nan),
        velocity_error_mps=np.where(hit, np.hypot(*np.moveaxis(error[..., VEL], -1, 0)), np.nan),
        gospa_m=np.sqrt(paired + unpaired))


def _nearest(distance: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distance (...,) and error (..., 4) of the estimate that is nearest."""
    if distance.shape[-1] == 0:
        return np.full(distance.shape[:-1], np.inf), np.full(
            (*distance.shape[:-1], error.shape[-1]), np.nan)
    index = distance.argmin(axis=-1)[..., None]
    nearest = np.take_along_axis(distance, index, axis=-1)[..., 0]
    return nearest, np.take_along_axis(error, index[..., None], axis=-2)[..., 0, :]
