# SPDX-License-Identifier: Apache-2.0
"""Intervals over runs, against closed forms and known cases."""

from lowsnr_eval.scoring.metrics import wilson_interval
from lowsnr_eval.study.bootstrap import bootstrap
from lowsnr_eval.study.bootstrap import mean_square_band
from lowsnr_eval.study.bootstrap import share_interval
import numpy as np
import pytest


def mean(sums):
    return sums[..., 0] / sums[..., 1]


def with_count(values):
    return np.stack([values, np.ones_like(values)], axis=1)


def test_bootstrap_of_a_mean_is_the_normal_interval(rng):
    values = rng.normal(2.0, 3.0, 400)
    effect = bootstrap(with_count(values), mean, 0)
    half = 1.96 * values.std() / np.sqrt(400)
    assert effect.value == pytest.approx(values.mean())
    # 2000 draws place a quantile to about a twentieth of the half width.
    assert effect.interval == pytest.approx(
        (values.mean() - half, values.mean() + half), abs=0.12 * half)


def test_bootstrap_interval_covers_the_mean_as_often_as_nominal(rng):
    covered = 0
    for trial in range(200):
        low, high = bootstrap(with_count(rng.normal(0.0, 1.0, 60)), mean, trial).interval
        covered += low <= 0.0 <= high
    # Binomial, 200 trials at 0.94 (60 runs are few), 4 sigma.
    assert abs(covered / 200 - 0.94) < 0.07


def test_interval_of_equal_runs_has_no_width():
    assert bootstrap(with_count(np.full(20, 0.25)), mean, 0).interval == (0.25, 0.25)


@pytest.mark.parametrize('runs', [0, 5])
def test_figure_without_data_is_none(runs):
    with np.errstate(invalid='ignore'):
        effect = bootstrap(np.zeros((runs, 2)), mean, 0)
    assert (effect.value, effect.interval) == (None, None)


def test_share_of_independent_trials_has_wilsons_interval(rng):
    trials = np.ones(300)
    successes = (rng.random(300) < 0.3).astype(float)
    expected = wilson_interval(int(successes.sum()), 300)
    assert share_interval(successes, trials) == pytest.approx(expected, rel=0.01)


def test_trials_that_repeat_each_other_count_once(rng):
    once = (rng.random(100) < 0.4).astype(float)
    repeated = share_interval(30.0 * once, np.full(100, 30.0))
    assert repeated == pytest.approx(share_interval(once, np.ones(100)), rel=0.02)


def test_share_without_trials_has_no_interval():
    assert share_interval(np.zeros(4), np.zeros(4)) is None
    low, high = share_interval(np.zeros(4), np.full(4, 10.0))
    assert low == 0.0
    assert high == pytest.approx(wilson_interval(0, 40)[1])


def test_band_of_a_root_mean_square_covers_it(rng):
    errors = rng.normal(0.0, 2.0, (100, 300))
    errors[rng.random(errors.shape) < 0.3] = np.nan
    value, low, high = mean_square_band(errors**2)
    assert np.all((low <= value) & (value <= high))
    # 300 frames at 95 %, 4 sigma.
    assert np.mean((low <= 2.0) & (high >= 2.0)) > 0.89


def test_band_needs_two_errors():
    value, low, high = mean_square_band(np.array([[4.0, np.nan], [np.nan, np.nan]]))
    assert value[0] == 2.0
    assert np.isnan([value[1], low[0], high[0]]).all()
