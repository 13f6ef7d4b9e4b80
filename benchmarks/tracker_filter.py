# SPDX-License-Identifier: Apache-2.0
"""Figures of the filter: consistency, mode probabilities and errors against an exact filter."""

from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from typing import Any

from lowsnr_track.pda_mmpf import PdaMmpf
import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student
import tracker_model as model
from tracker_scores import interval

FRAMES = 20
MODE_FRAMES = 8
MODE_REPEATS = 10
MODE_PARTICLES = 20_000


def consistency(
    pool: Executor, runs: int, seed: int, particles: int,
) -> dict[str, Any]:
    """Track objects that appear as in the tracker's model; return the NEES of their states."""
    tracker = replace(model.MODEL, particles=particles)
    nees = np.array(list(pool.map(
        partial(_born_nees, tracker, seed), range(runs), chunksize=10)))
    return {'particles': particles, 'runs': runs, 'frames': FRAMES, **_inside(nees)}


def against_exact(
    pool: Executor, runs: int, seed: int, particles: tuple[int, ...],
) -> dict[str, Any]:
    """Track objects from a Gaussian prior, and compare with the exact filter."""
    followed = list(pool.map(
        partial(_with_exact, seed, particles), range(runs), chunksize=5))
    exact, *others = ([run[n] for run in followed] for n in range(len(particles) + 1))
    result: dict[str, Any] = {
        'runs': runs, 'frames': FRAMES, 'exact': {**_rmse(exact), **_inside(_nees(exact))}}
    rng = np.random.default_rng([seed, 3])
    for count, runs_of in zip(particles, others):
        excess = {
            name: _excess(runs_of, exact, axes, rng)
            for name, axes in (('position', [0, 2]), ('velocity', [1, 3]))}
        result[str(count)] = {**_rmse(runs_of), 'excess': excess, **_inside(_nees(runs_of))}
    return result


def mode_probabilities(pool: Executor, runs: int, seed: int) -> dict[str, Any]:
    """
    Compare mode probabilities with the exact ones, on short sequences.

    Each sequence is filtered several times.  ``inside_95`` is the proportion of estimates inside
    their 95 % interval, whose width comes from the other repeats; the error of the mean over the
    repeats shows the bias.
    """
    pairs = list(pool.map(partial(_modes, seed), range(runs)))
    exact = np.array([pair[0] for pair in pairs])
    found = np.array([pair[1] for pair in pairs])
    error = found.mean(axis=1) - exact
    scale = found.std(axis=1, ddof=1)
    # The spread for each repeat is that of the others, without itself.
    others = np.array([
        np.delete(found, n, axis=1).std(axis=1, ddof=1) for n in range(MODE_REPEATS)])
    single = abs(np.moveaxis(found, 1, 0) - exact)
    inside = single <= student.ppf(0.975, MODE_REPEATS - 2) * others
    return {
        'sequences': runs, 'frames': MODE_FRAMES, 'particles': MODE_PARTICLES,
        'repeats': MODE_REPEATS, 'inside_95': float(inside.mean()),
        'rms_error_of_mean': float(np.sqrt(np.mean(error**2))),
        'monte_carlo_std': float(np.sqrt(np.mean(scale**2)))}


def _born_nees(tracker: PdaMmpf, seed: int, run: int) -> np.ndarray:
    rng = np.random.default_rng([seed, 0, run])
    states, detections = model.simulate(tracker, FRAMES, True, rng)
    return model.follow(tracker, states, detections, True, rng).nees


def _with_exact(seed: int, particles: tuple[int, ...], run: int) -> list[model.Followed]:
    states, detections = model.simulate(
        model.MODEL, FRAMES, False, np.random.default_rng([seed, 1, run]))
    return [model.follow_exactly(model.MODEL, states, detections, 5000)] + [
        model.follow(replace(model.MODEL, particles=count), states, detections, False,
                     np.random.default_rng([seed, 1, run, count])) for count in particles]


def _modes(seed: int, run: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng([seed, 2, run])
    states, detections = model.simulate(model.MODEL, MODE_FRAMES, False, rng)
    tracker = replace(model.MODEL, particles=MODE_PARTICLES)
    exact = model.follow_exactly(tracker, states, detections, 50_000).modes
    return exact, np.array([
        model.follow(tracker, states, detections, False, rng).modes
        for _ in range(MODE_REPEATS)])


def _nees(followed: list[model.Followed]) -> np.ndarray:
    return np.array([run.nees for run in followed])


def _inside(nees: np.ndarray) -> dict[str, Any]:
    """
    Return the proportion of frames whose mean NEES lies inside its 95 % bounds.

    ``chi_square`` bounds hold for a Gaussian posterior.  The posterior over several modes and
    hypotheses is not Gaussian, even where it is exact; ``sample`` bounds use the spread of runs.
    """
    runs, mean = len(nees), nees.mean(axis=0)
    low, high = chi2.ppf([0.025, 0.975], 4 * runs) / runs
    spread = 1.96 * nees.std(axis=0, ddof=1) / np.sqrt(runs)
    return {
        'nees': float(mean.mean()), 'interval': interval(nees, np.random.default_rng(runs)),
        'nees_low': float(mean.min()), 'nees_high': float(mean.max()),
        'chi_square': float(np.mean((mean >= low) & (mean <= high))),
        'sample': float(np.mean(abs(mean - 4.0) <= spread))}


def _rmse(followed: list[model.Followed]) -> dict[str, float]:
    error = np.array([run.error for run in followed])
    return {
        name: float(np.sqrt(np.mean(np.sum(error[..., axes]**2, axis=-1))))
        for name, axes in (('position', [0, 2]), ('velocity', [1, 3]))}


def _excess(
    followed: list[model.Followed], exact: list[model.Followed], axes: list[int],
    rng: np.random.Generator,
) -> tuple[float, float, float]:
    """Return the relative excess of the RMSE over the exact one, with its 95 % interval."""
    squared, best = (
        np.array([np.sum(run.error[:, axes]**2) for run in runs]) for runs in (followed, exact))
    draw = rng.integers(len(best), size=(1000, len(best)))
    draws = np.sqrt(squared[draw].sum(axis=1) / best[draw].sum(axis=1)) - 1.0
    low, high = np.quantile(draws, [0.025, 0.975])
    return float(np.sqrt(squared.sum() / best.sum()) - 1.0), float(low), float(high)
