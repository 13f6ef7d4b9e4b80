# SPDX-License-Identifier: Apache-2.0
"""The paper's claims, and the verdicts on them."""

from dataclasses import replace

from lowsnr_eval.report.study_report import claims_html
from lowsnr_eval.report.study_report import claims_markdown
from lowsnr_eval.study.examples import Claim
from lowsnr_eval.study.examples import CLAIMS
from lowsnr_eval.study.examples import EXAMPLES
from lowsnr_eval.study.run_scores import RunScores
from lowsnr_eval.study.study import LEVELS
from lowsnr_eval.study.verdicts import claim_verdicts
from lowsnr_eval.study.verdicts import compare_sides
from lowsnr_eval.study.verdicts import cost_verdict
from lowsnr_eval.study.verdicts import FAILS
from lowsnr_eval.study.verdicts import HOLDS
from lowsnr_eval.study.verdicts import threshold_dependence
import numpy as np
import pytest

RUNS, FRAMES = 60, 20
CLAIM = Claim('x', 3, 'one beats the other', 'one', 'other')


def scores(rng, pd, error=1.0, present=True):
    """Return scores of a chain that hits with a probability, with a constant error."""
    shape = (RUNS, FRAMES)
    hit = (rng.random(shape) < pd) & present
    errors = np.where(hit, error, np.nan)
    return RunScores(
        np.full(shape, present), hit.astype(int), hit, np.zeros(shape, int), errors, errors,
        np.zeros(shape))


def test_difference_is_that_of_the_shares(rng):
    one, other = scores(rng, 0.7), scores(rng, 0.5)
    effect = compare_sides(CLAIM, 'pd', one, other, 0)
    difference = one.hit.mean(axis=1) - other.hit.mean(axis=1)
    assert effect.value == pytest.approx(difference.mean())
    half = 1.96 * difference.std() / np.sqrt(RUNS)
    assert effect.interval == pytest.approx(
        (effect.value - half, effect.value + half), abs=0.2 * half)


def test_smaller_error_is_better(rng):
    effect = compare_sides(
        CLAIM, 'rmse_position_m', scores(rng, 0.5, 0.4), scores(rng, 0.5, 1.0), 0)
    assert effect.value == pytest.approx(0.6)
    assert effect.interval == pytest.approx((0.6, 0.6))


def test_only_frames_that_count_are_compared(rng):
    one = scores(rng, 1.0)
    one.hit[:, 10:] = False
    claim = replace(CLAIM, better_frames=((1, 5), (6, 10)), worse_frames=((11, 20),))
    assert compare_sides(claim, 'pd', one, one, 0).value == pytest.approx(1.0)
    assert compare_sides(CLAIM, 'pd', one, one, 0).interval == (0.0, 0.0)


def test_bound_replaces_the_other_side(rng):
    one = scores(rng, 0.6)
    effect = compare_sides(replace(CLAIM, bound=0.5), 'pd', one, None, 0)
    assert effect.value == pytest.approx(one.hit.mean() - 0.5)


def verdict_rows(rng, pd_sdt, pd_cdt):
    found = {}
    for point, sdt, cdt in (('nominal', pd_sdt, pd_cdt), ('matched', pd_cdt, pd_sdt)):
        for level in ('detection', 'tracking'):
            found['sdt', point, level] = scores(rng, sdt)
            found['cdt', point, level] = scores(rng, cdt)
    quiet = {key: scores(rng, 0.0, present=False) for key in found}
    return claim_verdicts(3, 6.0, found, quiet, ('nominal', 'matched'), 0)


def test_verdict_follows_from_the_interval(rng):
    rows = verdict_rows(rng, 0.8, 0.4)
    assert [row['decides'] for row in rows] == [True, False, False, False]
    points = rows[0]['operating_points']
    assert points['nominal']['verdict'] == HOLDS
    assert points['matched']['verdict'] == FAILS
    assert points['matched']['pfa_better'] == 0.0
    assert points['nominal']['runs'] == RUNS
    # Its sentence states both verdicts, the nominal one first.
    assert 0 < rows[0]['turns'].index(HOLDS) < rows[0]['turns'].index(FAILS)
    # The errors of both sides are equal, so that their difference and its interval are zero.
    assert unresolved(rows[2]['operating_points']['nominal'])


def unresolved(verdict):
    return verdict['verdict'] not in (HOLDS, FAILS)


def test_error_of_too_few_hits_is_not_resolved(rng):
    found = {('sdt', 'nominal', level): scores(rng, 0.8, 0.4) for level in LEVELS}
    found |= {('cdt', 'nominal', level): scores(rng, 0.8) for level in LEVELS}
    errors = found['cdt', 'nominal', 'tracking'].position_error_m.copy()
    errors[9:] = np.nan
    found['cdt', 'nominal', 'tracking'] = replace(
        found['cdt', 'nominal', 'tracking'], position_error_m=errors)
    verdicts = {(row['level'], row['measure']): row['operating_points']['nominal']
                for row in claim_verdicts(3, 6.0, found, {}, ('nominal',), 0)}
    few = verdicts['tracking', 'rmse_position_m']
    assert few['effect'] == pytest.approx(0.6)
    assert (few['interval'], few['telling_runs']) == (None, 9)
    assert unresolved(few)
    assert few['runs'] == RUNS
    assert verdicts['tracking', 'rmse_velocity_mps']['verdict'] == HOLDS


def test_nothing_to_compare_is_not_resolved(rng):
    rows = verdict_rows(rng, 0.5, 0.0)
    nominal = rows[2]['operating_points']['nominal']
    assert nominal['effect'] is None
    assert unresolved(nominal)
    assert 'class="open"' in claims_html(rows)


def test_claim_of_methods_that_did_not_run_has_no_verdict(rng):
    found = {('sdt', 'nominal', 'detection'): scores(rng, 0.5)}
    assert claim_verdicts(3, 6.0, found, {}, ('nominal',), 0) == []


def test_verdict_on_cost_compares_blocks_in_pairs(rng):
    common = rng.uniform(1e-3, 2e-3, (25, 2))
    times = {(name, point): common + more for point in ('nominal', 'matched')
             for name, more in (('sdt', 0.0), ('sdt_r2', 3e-4))}
    row, = cost_verdict(times, ('nominal', 'matched'), 3.0, 500, 0)
    for found in row['operating_points'].values():
        assert found['verdict'] == HOLDS
        assert found['effect'] == pytest.approx(0.3)
        assert found['interval'] == pytest.approx((0.3, 0.3))
    assert 'time [ms]' in claims_markdown([row])
    del times['sdt_r2', 'matched']
    assert cost_verdict(times, ('nominal', 'matched'), 3.0, 500, 0) == []


def test_verdicts_that_agree_need_no_sentence():
    assert threshold_dependence(
        {'nominal': {'verdict': HOLDS}, 'matched': {'verdict': HOLDS}}) is None


def test_every_example_has_claims_whose_methods_run_in_full():
    assert {claim.example for claim in CLAIMS} == set(EXAMPLES)
    for claim in CLAIMS:
        assert {claim.better, claim.worse} - {''} <= set(EXAMPLES[claim.example].compared)


def test_tables_show_the_deciding_figures(rng):
    rows = verdict_rows(rng, 0.8, 0.4)
    lines = claims_markdown(rows).splitlines()
    assert len(lines) == 3
    assert lines[2].count('|') == 7
    assert f'**{HOLDS}** +0.' in lines[2]
    assert 'class="fails"' in claims_html(rows)
