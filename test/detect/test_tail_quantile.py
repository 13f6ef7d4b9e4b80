# SPDX-License-Identifier: Apache-2.0
"""Upper quantiles: counted where the sample shows them, from the fitted tail elsewhere."""

from lowsnr_detect.calibration.tail_quantile import upper_quantile
from lowsnr_detect.calibration.tail_quantile import upper_quantiles
import numpy as np
import pytest
from scipy.stats import norm


def test_common_quantile_is_that_of_the_sample(rng):
    values = rng.standard_normal(10_000)
    assert upper_quantile(values, 0.05) == np.quantile(values, 0.95)


@pytest.mark.parametrize('prob', [3e-4, 3e-5])
def test_rare_quantile_of_gaussian_maxima(rng, prob):
    # The largest of 400 normal numbers, 10 000 of them; the quantile has closed form.
    uniform = rng.random((30, 10_000))
    values = norm.isf(-np.expm1(np.log(uniform) / 400))
    exact = norm.isf(-np.expm1(np.log1p(-prob) / 400))
    found = np.array([upper_quantile(sample, prob) for sample in values])
    assert found.mean() == pytest.approx(exact, abs=4 * found.std() / np.sqrt(30) + 0.03)
    assert found.std() < 0.25


def test_exponential_tail_is_exact_on_average(rng):
    found = [upper_quantile(sample, 1e-4) for sample in rng.exponential(size=(60, 20_000))]
    assert np.mean(found) == pytest.approx(np.log(1e4), abs=4 * np.std(found) / np.sqrt(60) + 0.1)


@pytest.mark.parametrize(('values', 'expected'), [
    ([-np.inf, -np.inf, -np.inf, -np.inf], 0.0),
    ([-np.inf, -np.inf, -np.inf, 2.0], np.nextafter(2.0, 0.0)),
    ([1.0, 1.0, 1.0, 1.0], 1.0),
])
def test_degenerate_samples(values, expected):
    assert upper_quantile(np.array(values), 0.3) == expected


def test_rare_quantile_with_few_finite_values_is_finite(rng):
    values = np.full(5000, -np.inf)
    values[:60] = rng.exponential(size=60)
    assert 1.0 < upper_quantile(values, 1e-3) < 10.0


def test_quantiles_are_found_together_as_one_by_one(rng):
    # Counted ones, ones from the tail, and ones out of reach.
    values = np.where(rng.random(8000) < 0.6, rng.exponential(size=8000), -np.inf)
    probs = np.array([0.9, 0.59, 0.3, 0.02, 1e-2, 1e-3, 1e-6])
    found = upper_quantiles(values, probs)
    assert found.tolist() == [upper_quantile(values, prob) for prob in probs.tolist()]
    finite = values[np.isfinite(values)]
    assert found[2] == np.quantile(finite, 1.0 - 0.3 * 8000 / len(finite))
    assert found[0] < finite.min()
    assert np.all(np.diff(found) > 0.0)
