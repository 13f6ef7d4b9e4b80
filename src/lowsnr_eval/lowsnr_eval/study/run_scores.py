# SPDX-License-Identifier: Apache-2.0
"""
Scores of many runs with at most one object, as in the paper, and figures of merit of them.

The scores are those of :func:`lowsnr_eval.scoring.frame_scoring.compare`.  One object needs no
assignment of estimates to objects, so that all frames of all runs are scored together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import fields
from typing import Any

from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_eval.scoring.metrics import ratio
from lowsnr_eval.scoring.metrics import root_mean_square
from lowsnr_eval.scoring.metrics import wilson_interval
from lowsnr_eval.study.bootstrap import mean_square_band
from lowsnr_eval.study.bootstrap import share_interval
import numpy as np

CURVES = ('pd', 'rmse_position_m', 'rmse_velocity_mps', 'gospa_m')


@dataclass(frozen=True)
class RunScores:
    """
    The number of estimates in every frame of every run, and their errors.

    Parameters
    ----------
    present : (runs, frames) ndarray of bool
        Whether the object is present.
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
        Estimates, NaN in unused slots; a velocity that is not estimated is NaN.
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


def figures_of_merit(scores: RunScores) -> dict[str, Any]:
    """
    Return the figures of merit over all frames of all runs; None where there is no data.

    ``pd`` is over frames with the object, ``pfa_per_frame`` over frames without it, and
    ``gospa_m`` over all.  The intervals allow for the dependence of the frames of a run.
    """
    present, declared = scores.present, scores.declared > 0
    false = declared & ~present
    errors = scores.position_error_m, scores.velocity_error_mps
    position, velocity = (error[np.isfinite(error)] for error in errors)
    objects, empty = present.sum(axis=1), (~present).sum(axis=1)
    return {
        'pd': ratio(int(scores.hit.sum()), int(objects.sum())),
        'pd_interval': share_interval(scores.hit.sum(axis=1), objects),
        'pfa_per_frame': ratio(int(false.sum()), int(empty.sum())),
        'pfa_interval': share_interval(false.sum(axis=1), empty),
        'rmse_position_m': root_mean_square(position),
        'rmse_velocity_mps': root_mean_square(velocity),
        'gospa_m': root_mean_square(scores.gospa_m),
        'hits': len(position),
        'hits_with_velocity': len(velocity),
        'false_alarms_per_frame': ratio(int(scores.false_alarms.sum()), scores.present.size),
    }


def frame_curves(scores: RunScores) -> dict[str, np.ndarray]:
    """
    Return the figures of merit of every frame over the runs, with 95 % bands.

    Returns
    -------
    dict
        For each of ``CURVES`` an array (3, frames): value, lower and upper bound, NaN where
        there is no data; and ``declared``, the share of runs with any declaration.

    """
    squares = (scores.position_error_m, scores.velocity_error_mps, scores.gospa_m)
    bands = [np.stack(mean_square_band(np.square(values))) for values in squares]
    pd = _share_curve(scores.hit, scores.present)
    return dict(zip(CURVES, [pd, *bands])) | {
        'declared': _share_curve(scores.declared > 0, np.ones_like(scores.present))}


def _nearest(distance: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distance (...,) and error (..., 4) of the nearest estimate."""
    if distance.shape[-1] == 0:
        return np.full(distance.shape[:-1], np.inf), np.full(
            (*distance.shape[:-1], error.shape[-1]), np.nan)
    index = distance.argmin(axis=-1)[..., None]
    nearest = np.take_along_axis(distance, index, axis=-1)[..., 0]
    return nearest, np.take_along_axis(error, index[..., None], axis=-2)[..., 0, :]


def _share_curve(success: np.ndarray, trial: np.ndarray) -> np.ndarray:
    curve = np.full((3, trial.shape[1]), np.nan)
    for k, (hits, trials) in enumerate(zip(success.sum(axis=0), trial.sum(axis=0))):
        interval = wilson_interval(int(hits), int(trials))
        if interval is not None:
            curve[:, k] = hits / trials, *interval
    return curve
