# SPDX-License-Identifier: Apache-2.0
"""What the tracks of a run are worth: hits, time to the first one, what is left after the end."""

from collections.abc import Iterator
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from lowsnr_common.core.motion import POS
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_eval.scoring import metrics
from lowsnr_track.tracks import TrackerOutput
import numpy as np

GATE_M = Evaluation().gate_m
AFTER_FRAMES = 5
BINS = 10


@dataclass(frozen=True)
class RunScore:
    """
    The tracks of one run, K frames, against its object.

    Parameters
    ----------
    hit : (K,) ndarray of bool
        Whether a confirmed track is within the gate.
    false : (K,) ndarray of int
        Other confirmed tracks.
    squared, nees : (K,) ndarray
        Squared error of the nearest position [m^2], and the squared normalised error of its
        state; NaN without a hit.
    first : float
        Frames from the first one with the object to the first hit; infinite without any.
    after : (AFTER_FRAMES,) ndarray
        Whether the track of the object's last frame is still there; NaN if it had none.
    existence : (tracks, 2) ndarray
        Stated existence of each track of each frame, tentative ones included, and whether it has
        an object, one with one within the gate.

    """

    hit: np.ndarray
    false: np.ndarray
    squared: np.ndarray
    nees: np.ndarray
    first: float
    after: np.ndarray
    existence: np.ndarray


def score_run(truth: np.ndarray, outputs: Sequence[TrackerOutput]) -> RunScore:
    """Score the tracks of a run against the states (K, 4), NaN in frames without the object."""
    frames = [_frame(state, output) for state, output in zip(truth, outputs)]
    count, away, nees = (np.array(part) for part in zip(*frames))
    hit, present = away <= GATE_M, np.flatnonzero(np.isfinite(truth[:, 0]))
    first = np.inf
    if hit.any():
        first = float(np.argmax(hit) - present[0])
    existence = [pair for state, output in zip(truth, outputs) for pair in _stated(state, output)]
    return RunScore(
        hit, count - hit, np.where(hit, away, np.nan)**2, np.where(hit, nees, np.nan), first,
        _after(truth, outputs, present), np.reshape(existence, (-1, 2)))


def _frame(state: np.ndarray, output: TrackerOutput) -> tuple[int, float, float]:
    """Return the confirmed tracks, and distance and NEES of the nearest one."""
    errors = [item.state - state for item in output.confirmed]
    away = [float(np.hypot(*error[POS])) for error in errors]
    if not away or not np.isfinite(away).all():
        return len(away), np.inf, np.nan
    n = int(np.argmin(away))
    nees = float(errors[n] @ np.linalg.solve(output.confirmed[n].cov, errors[n]))
    return len(away), away[n], nees


def _stated(state: np.ndarray, output: TrackerOutput) -> Iterator[tuple[float, bool]]:
    tracks = output.confirmed + output.tentative
    objects = state[None, POS][np.isfinite(state[:1])]
    places = np.reshape([item.state[POS] for item in tracks], (-1, 2))
    _, paired = metrics.match_within_gate(metrics.distances(objects, places), GATE_M)
    for n, item in enumerate(tracks):
        yield item.score, n in paired


def _after(
    truth: np.ndarray, outputs: Sequence[TrackerOutput], present: np.ndarray,
) -> np.ndarray:
    none = np.full(AFTER_FRAMES, np.nan)
    if present.size == 0:
        return none
    last = present[-1]
    ids = {item.id for item in outputs[last].confirmed
           if np.hypot(*(item.state[POS] - truth[last, POS])) <= GATE_M}
    if not ids:
        return none
    later = outputs[last + 1:last + 1 + AFTER_FRAMES]
    return np.array([bool(ids & {item.id for item in output.confirmed}) for output in later])


def reliability(
    runs: Sequence[np.ndarray], weights: Sequence[float], rng: np.random.Generator,
) -> dict[str, Any]:
    """
    Compare stated existence with the share of tracks that have an object.

    Parameters
    ----------
    runs : (R,) sequence of (tracks, 2) ndarray
        As ``existence`` of each run.
    weights : (R,) sequence of float
        Weight of each run.
    rng
        Source of randomness of the bootstrap.

    Returns
    -------
    dict
        For ten bins of equal width: ``tracks``, ``stated`` existence and share ``with_object``,
        NaN of an empty bin.  ``largest`` is the largest difference, with its 95 % interval by a
        bootstrap over runs.

    """
    sums = np.array([_sums(run) for run in runs])  # (R, 3, BINS)
    weighted = sums * np.reshape(weights, (-1, 1, 1))
    total, stated, true = weighted.sum(axis=0)
    drawn = [_largest(weighted[rng.integers(len(runs), size=len(runs))].sum(axis=0))
             for _ in range(1000)]
    with np.errstate(invalid='ignore'):
        return {
            'tracks': sums[:, 0].sum(axis=0).astype(int).tolist(),
            'stated': (stated / total).tolist(), 'with_object': (true / total).tolist(),
            'largest': (_largest(weighted.sum(axis=0)),
                        *np.quantile(drawn, [0.025, 0.975]).tolist())}


def _sums(pairs: np.ndarray) -> np.ndarray:
    """Return number, stated existence and objects of the tracks of each bin, (3, BINS)."""
    place = np.minimum((BINS * pairs[:, 0]).astype(int), BINS - 1)
    return np.array([np.bincount(place, part, BINS)
                     for part in (np.ones(len(pairs)), *pairs.T)])


def _largest(sums: np.ndarray) -> float:
    total, stated, true = sums[:, sums[0] > 0]
    return float(np.max(abs(stated - true) / total))


def interval(shares: np.ndarray, rng: np.random.Generator) -> tuple[float, float, float]:
    """
    Return the mean of (runs,) or (runs, frames) and its 95 % interval, by a bootstrap over runs.

    NaN counts for nothing.
    """
    columns = shares.reshape(len(shares), -1)
    total, count = np.nansum(columns, axis=1), np.isfinite(columns).sum(axis=1)
    draw = rng.integers(len(shares), size=(1000, len(shares)))
    low, high = np.quantile(
        total[draw].sum(axis=1) / count[draw].sum(axis=1), [0.025, 0.975])
    return float(total.sum() / count.sum()), float(low), float(high)


def quantile_interval(
    values: np.ndarray, quantile: float, rng: np.random.Generator,
) -> tuple[float, float, float]:
    """Return a quantile over runs (the next value that occurred), with its 95 % interval."""
    drawn = values[rng.integers(len(values), size=(1000, len(values)))]
    each = np.quantile(drawn, quantile, axis=1, method='inverted_cdf')
    low, high = np.quantile(each, [0.025, 0.975], method='inverted_cdf')
    found = np.quantile(values, quantile, method='inverted_cdf')
    return float(found), float(low), float(high)
