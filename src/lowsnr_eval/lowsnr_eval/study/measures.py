"""The figures of a chain over many runs: one number each, or one for every frame."""

from __future__ import annotations

from typing import Any

from lowsnr_eval.scoring.metrics import ratio
from lowsnr_eval.scoring.metrics import root_mean_square
from lowsnr_eval.scoring.metrics import wilson_interval
from lowsnr_eval.study.bootstrap import mean_square_band
from lowsnr_eval.study.bootstrap import share_interval
from lowsnr_eval.study.run_scores import RunScores
import numpy as np

CURVES = ('pd', 'rmse_position_m', 'rmse_velocity_mps', 'gospa_m')


def point_figures(scores: RunScores) -> dict[str, Any]:
    """
    Return the figures over all frames of all runs; None for those that do not exist.

    ``pd`` is over frames with the object, ``pfa_per_frame`` over frames without it,
    ``gospa_m`` over all.  Their intervals allow for the dependence of frames in a run.
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
    Return the figures of every frame over the runs, with 95 % bands.

    Returns
    -------
    dict
        For each of ``CURVES`` an array (3, frames): value, lower and upper bound; NaN where
        a figure does not exist; and ``declared``, the share of runs with any declaration.

    """
    squares = (scores.position_error_m, scores.velocity_error_mps, scores.gospa_m)
    bands = [np.stack(mean_square_band(np.square(values))) for values in squares]
    pd = _share_curve(scores.hit, scores.present)
    return dict(zip(CURVES, [pd, *bands])) | {
        'declared': _share_curve(scores.declared > 0, np.ones_like(scores.present))}


def _share_curve(success: np.ndarray, trial: np.ndarray) -> np.ndarray:
    curve = np.full((3, trial.shape[1]), np.nan)
    for k, (hits, trials) in enumerate(zip(success.sum(axis=0), trial.sum(axis=0))):
        interval = wilson_interval(int(hits), int(trials))
        if interval is not None:
            curve[:, k] = hits / trials, *interval
    return curve
