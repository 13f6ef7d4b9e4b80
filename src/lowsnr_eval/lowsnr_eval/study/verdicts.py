# SPDX-License-Identifier: Apache-2.0
"""Verdicts on the paper's claims, from paired runs, at every operating point."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lowsnr_eval.study.bootstrap import bootstrap
from lowsnr_eval.study.bootstrap import Effect
from lowsnr_eval.study.examples import Claim
from lowsnr_eval.study.examples import CLAIMS
from lowsnr_eval.study.examples import COST_CLAIM
from lowsnr_eval.study.examples import Frames
from lowsnr_eval.study.examples import PD
from lowsnr_eval.study.examples import POSITION
from lowsnr_eval.study.run_scores import figures_of_merit
from lowsnr_eval.study.run_scores import RunScores
import numpy as np

HOLDS, FAILS = 'holds', 'does not hold'
# Fewer runs do not show how much runs differ.
_LEAST_RUNS = 10
# Method, operating point and level.
Key = tuple[str, str, str]
Scores = Mapping[Key, RunScores]
# Times of detector and tracker for a frame, (blocks, 2) [s], by method and operating point.
Times = Mapping[tuple[str, str], np.ndarray]


def claim_verdicts(
    example: int, snr_db: float, scores: Scores, empty: Scores, points: tuple[str, ...],
    seed: int,
) -> list[dict[str, Any]]:
    """
    Return the verdicts on the claims of an example at one SNR.

    Parameters
    ----------
    example
        Number of the example.
    snr_db
        SNR [dB], for the rows.
    scores
        Scores of the runs with the object.
    empty
        Scores of the runs without it, for the false-alarm rates.
    points
        Operating points.
    seed
        Seed of the bootstrap.

    Returns
    -------
    list of dict
        One for each claim and figure; none for a claim whose methods did not run.

    """
    rows = []
    for claim in (claim for claim in CLAIMS if claim.example == example):
        names = {claim.better, claim.worse} - {''}
        if not all((name, points[0], 'detection') in scores for name in names):
            continue
        for number, (level, measure) in enumerate(claim.measures):
            rows.append(_row(claim, snr_db, number, {
                point: _verdict(claim, level, measure, point, scores, empty, seed)
                for point in points}))
    return rows


def cost_verdict(
    times_s: Times, points: tuple[str, ...], snr_db: float, runs: int, seed: int,
) -> list[dict[str, Any]]:
    """Return the verdict on the claim on CPU time, as a list: empty if it was not measured."""
    verdicts = {}
    for point in points:
        both = [times_s.get((name, point)) for name in (COST_CLAIM.better, COST_CLAIM.worse)]
        if any(side is None for side in both):
            return []
        spent_ms = 1e3 * np.stack([side[:, 0] for side in both if side is not None], axis=1)
        more_ms = np.stack([spent_ms[:, 0] - spent_ms[:, 1], np.ones(len(spent_ms))], axis=1)
        verdicts[point] = _from_effect(bootstrap(more_ms, _share, seed), runs, runs)
    return [_row(COST_CLAIM, snr_db, 0, verdicts)]


def threshold_dependence(verdicts: Mapping[str, Mapping[str, Any]]) -> str | None:
    """Return a sentence on how a verdict depends on the operating point; None if it does not."""
    found = {point: verdict['verdict'] for point, verdict in verdicts.items()}
    if len({text if text in (HOLDS, FAILS) else None for text in found.values()}) < 2:
        return None
    words = {
        'nominal': 'at the nominal thresholds', 'matched': 'at the same false-alarm rate'}
    sentence = ', '.join(
        f'{words.get(point, point)} it {"" if text in (HOLDS, FAILS) else "is "}{text}'
        for point, text in found.items())
    return f'{sentence[0].upper()}{sentence[1:]}.'


def compare_sides(
    claim: Claim, measure: str, better: RunScores, worse: RunScores | None, seed: int,
) -> Effect:
    """
    Return by how much the first side of a claim is better, over paired runs.

    Parameters
    ----------
    claim
        Gives the frames that count, and the bound if there is no other side.
    measure
        ``'pd'``, ``'rmse_position_m'`` or ``'rmse_velocity_mps'``.
    better, worse
        Scores of the sides; the runs that both have count.
    seed
        Seed of the bootstrap.

    """
    own = _sums(better, measure, claim.better_frames)
    if worse is None:
        return bootstrap(own, lambda sums: _share(sums) - claim.bound, seed)
    other = _sums(worse, measure, claim.worse_frames)
    runs = min(len(own), len(other))
    both = np.concatenate([own[:runs], other[:runs]], axis=1)
    if measure == PD:
        return bootstrap(both, lambda sums: _share(sums) - _share(sums[..., 2:]), seed)
    return bootstrap(
        both, lambda sums: np.sqrt(_share(sums[..., 2:])) - np.sqrt(_share(sums)), seed)


def _verdict(
    claim: Claim, level: str, measure: str, point: str, scores: Scores, empty: Scores,
    seed: int,
) -> dict[str, Any]:
    better = scores[claim.better, point, level]
    worse = scores.get((claim.worse, point, level))
    effect = compare_sides(claim, measure, better, worse, seed)
    counts = [_sums(scores, measure, frames)[:, 1]
              for scores, frames in ((better, claim.better_frames), (worse, claim.worse_frames))
              if scores is not None]
    runs = min(map(len, counts))
    telling = min(int(np.count_nonzero(count[:runs])) for count in counts)
    found = _from_effect(effect, runs, telling)
    for side, name in (('better', claim.better), ('worse', claim.worse)):
        quiet = empty.get((name, point, level))
        if quiet:
            found[f'pfa_{side}'] = figures_of_merit(quiet)['pfa_per_frame']
    return found


def _from_effect(effect: Effect, runs: int, telling: int) -> dict[str, Any]:
    """Return the verdict; ``telling`` runs contribute to the figure of the weaker side."""
    verdict = f'not resolved with {runs} runs'
    interval = effect.interval if telling >= _LEAST_RUNS else None
    if interval is not None:
        low, high = interval
        verdict = HOLDS if low > 0.0 else FAILS if high < 0.0 else verdict
    return {
        'verdict': verdict, 'effect': effect.value, 'interval': interval, 'runs': runs,
        'telling_runs': telling, 'pfa_better': None, 'pfa_worse': None}


def _row(
    claim: Claim, snr_db: float, number: int, verdicts: Mapping[str, Mapping[str, Any]],
) -> dict[str, Any]:
    level, measure = claim.measures[number]
    return {
        'claim': claim.key, 'sentence': claim.sentence, 'example': claim.example,
        'snr_db': snr_db, 'decides': number == 0, 'level': level, 'measure': measure,
        'better': claim.better, 'worse': claim.worse, 'reading': claim.reading,
        'operating_points': verdicts, 'turns': threshold_dependence(verdicts)}


def _sums(scores: RunScores, measure: str, frames: Frames) -> np.ndarray:
    """Return the contribution of each run to the sum of a figure and its count, (runs, 2)."""
    counts = scores.present.copy()
    if frames:
        number = np.arange(1, counts.shape[1] + 1)
        counts &= np.any([(number >= a) & (number <= b) for a, b in frames], axis=0)
    if measure == PD:
        values = scores.hit.astype(float)
    else:
        error = scores.position_error_m if measure == POSITION else scores.velocity_error_mps
        values, counts = np.square(error), counts & np.isfinite(error)
    return np.stack([np.where(counts, values, 0.0).sum(axis=1), counts.sum(axis=1)], axis=1)


def _share(sums: np.ndarray) -> np.ndarray:
    with np.errstate(invalid='ignore', divide='ignore'):
        share: np.ndarray = sums[..., 0] / sums[..., 1]
    return share
