# SPDX-License-Identifier: Apache-2.0
"""Models of noise against SciPy's distributions, numerical integration and samples."""

import math

from lowsnr_common.noise.empirical import Empirical
from lowsnr_common.noise.empirical import learned_quantiles
from lowsnr_common.noise.models import Poisson
from lowsnr_common.noise.settings import Noise
import numpy as np
import pytest
from scipy import integrate
from scipy import stats

STD = 1.7
NORMAL_QUANTILES = tuple(stats.norm.ppf(
    1.0 / (1.0 + np.exp(-np.linspace(-1.0, 1.0, 81) * math.log(999_999.0)))).tolist())
MODELS = {
    'gaussian': Noise(), 'student_t': Noise(model='student_t'),
    'rayleigh': Noise(model='rayleigh'),
    'k': Noise(model='k'), 'spiky k': Noise(model='k', shape=0.4),
    'poisson': Noise(model='poisson', background=2.5),
    'empirical': Noise(model='empirical', quantiles=NORMAL_QUANTILES)}


@pytest.fixture(params=MODELS)
def model(request):
    """Return each model of noise."""
    return MODELS[request.param].of_std(STD)


def envelope_moments(shape):
    """Return mean and standard deviation of the envelope of complex noise of power 1."""
    def moment(power):
        return integrate.quad(lambda t: stats.gamma.pdf(t, shape, scale=1.0 / shape)
                              * t**(power / 2.0), 0.0, np.inf)[0] * math.gamma(1.0 + power / 2.0)
    return moment(1), math.sqrt(moment(2) - moment(1)**2)


def density_of_k(a, amplitude, shape):
    """Return the density of the envelope of an object in K distributed clutter."""
    def joint(log_texture):
        texture = math.exp(log_texture)
        root = math.sqrt(texture / 2.0)
        rice = stats.rice.pdf(a, amplitude / root, scale=root)
        return rice * stats.gamma.pdf(texture, shape, scale=1.0 / shape) * texture
    return integrate.quad(joint, -15.0, 5.0, limit=400, epsabs=1e-10)[0]


@pytest.mark.parametrize('signal', [0.0, 3.1])
def test_gaussian_and_student_t_are_scipy_s(signal):
    z = np.linspace(-8.0, 12.0, 41)
    assert MODELS['gaussian'].of_std(STD).log_density(z, signal) == pytest.approx(
        stats.norm.logpdf(z, signal, STD))
    found = Noise(model='student_t', degrees_of_freedom=3.0).of_std(STD).log_density(z, signal)
    assert found == pytest.approx(stats.t.logpdf(z, 3.0, signal, STD / math.sqrt(3.0)))


@pytest.mark.parametrize('signal', [0.0, 3.1])
def test_rayleigh_is_the_distribution_of_rice_with_an_object(signal):
    mean, spread = math.sqrt(math.pi) / 2.0, math.sqrt(1.0 - math.pi / 4.0)
    a = np.linspace(0.01, 5.0, 40)
    expected = stats.rice.logpdf(a, signal / STD * math.sqrt(2.0), scale=math.sqrt(0.5))
    found = MODELS['rayleigh'].of_std(STD).log_density(STD * (a - mean) / spread, signal)
    assert found == pytest.approx(expected + math.log(spread / STD), abs=1e-9)


@pytest.mark.parametrize('shape', [0.7, 3.0])
@pytest.mark.parametrize('amplitude', [0.0, 1.8])
def test_k_is_the_mean_over_the_texture(shape, amplitude):
    mean, spread = envelope_moments(shape)
    model = Noise(model='k', shape=shape).of_std(STD)
    for a in (0.2, 0.9, 1.6, 2.6, 4.0):
        found = np.exp(model.log_density(STD * (a - mean) / spread, STD * amplitude))
        assert found * STD / spread == pytest.approx(
            density_of_k(a, amplitude, shape), rel=0.01, abs=1e-6)


@pytest.mark.parametrize('signal', [0.0, 2.0])
def test_poisson_is_scipy_s_at_whole_counts(signal):
    count, root = np.arange(12), math.sqrt(2.5)
    found = Poisson(STD, 2.5).log_density(STD * (count - 2.5) / root, signal)
    expected = stats.poisson.logpmf(count, 2.5 + root * signal / STD)
    assert found == pytest.approx(expected + math.log(root / STD))


def test_densities_integrate_to_one(model):
    if isinstance(model, Poisson):
        return  # its counts are whole; they are compared above
    grid = np.arange(-20.0, 60.0, 0.02)
    for signal in (0.0, 4.0):
        assert np.exp(model.log_density(grid, signal)).sum() * 0.02 == pytest.approx(
            1.0, abs=0.02)


def test_samples_have_the_density(model, rng):
    count = 40_000
    for signal in (0.0, 4.0):
        sample = model.draw(np.full(count, signal), rng)
        edges = np.quantile(sample, [0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98])
        if isinstance(model, Poisson):
            step = STD / math.sqrt(2.5)
            grid = step * (np.arange(40) - 2.5)
            edges += step / 2.0
        else:
            grid = np.arange(-20.0, 60.0, 0.02)
        mass = np.exp(model.log_density(grid, signal))
        for edge in edges:
            share = np.mean(sample <= edge)
            exact = mass[grid <= edge].sum() / mass.sum()
            assert abs(share - exact) < 5.0 * math.sqrt(0.25 / count) + 4e-3


def test_noise_alone_has_mean_zero_and_the_stated_deviation(model, rng):
    sample = model.draw(np.zeros(200_000), rng)
    # The variance of Student t samples with 4 degrees of freedom has itself none.
    assert sample.mean() == pytest.approx(0.0, abs=0.03)
    assert sample.std() == pytest.approx(STD, rel=0.08)


def test_gaussian_noise_is_that_of_the_generator():
    found = MODELS['gaussian'].of_std(STD).draw(np.zeros((3, 4)), np.random.default_rng(5))
    assert np.array_equal(found, STD * np.random.default_rng(5).standard_normal((3, 4)))


def test_learned_noise_has_the_log_ratio_of_its_source(rng):
    source = Noise(model='student_t').of_std(1.0)
    learned = Empirical(1.0, learned_quantiles(source.draw(np.zeros(400_000), rng)))
    z = np.linspace(-4.0, 6.0, 101)
    exact, found = (m.log_density(z, 2.0) - m.log_density(z, 0.0) for m in (source, learned))
    # Tails are fitted to 800 cells, and each interval between them holds 250 or more.
    assert np.abs(found - exact).max() < 0.5
    assert np.abs(found - exact).mean() < 0.1


# The last fraction is that of one cell in a frame of 20 x 20 at 1 % of the frames.
@pytest.mark.parametrize('rare', [1e-2, 1e-3, 1e-4, 0.01 / 400])
@pytest.mark.parametrize('source', [
    stats.norm(), stats.t(4, scale=math.sqrt(0.5)), stats.rayleigh(loc=-math.sqrt(math.pi / 2))])
def test_learned_noise_has_the_tails_of_its_source(source, rare):
    values = source.ppf((np.arange(1e6) + 0.5) / 1e6)
    side = source.isf(rare) / values.std()
    beyond, step = np.linspace(side, side + 40.0, 400_001, retstep=True)
    for sign in (1.0, -1.0):
        found = Empirical(1.0, learned_quantiles(sign * values))
        mass = np.exp(found.log_density(sign * beyond, 0.0)).sum() * step
        assert mass == pytest.approx(rare, rel=0.05)


def test_known_quantiles_leave_their_probability_beyond_them():
    found = Empirical(1.0, NORMAL_QUANTILES)
    for z in (3.0, 4.0, 4.7, 5.0):
        beyond = np.arange(z, 15.0, 1e-4)
        mass = np.exp(found.log_density(beyond, 0.0)).sum() * 1e-4
        assert mass == pytest.approx(stats.norm.sf(z), rel=0.15)


def test_learned_counts_keep_their_quantiles(rng):
    counts = Noise(model='poisson', background=9.0).of_std(1.0).draw(np.zeros(200_000), rng)
    quantiles = learned_quantiles(counts)
    assert np.all(np.diff(quantiles) > 0.0)
    sample = Empirical(1.0, quantiles).draw(np.zeros(200_000), rng)
    # A count is spread evenly over its step of a third.
    assert sample.mean() == pytest.approx(counts.mean(), abs=0.02)
    assert sample.var() == pytest.approx(counts.var() + 1.0 / 108.0, rel=0.03)


@pytest.mark.parametrize('values', [np.arange(99_999.0), np.tile([1.0, 2.0, 3.0], 50_000)])
def test_too_little_is_no_noise_to_learn_from(values):
    with pytest.raises(ValueError, match=r'^(99999 cells|150000 cells with 3 distinct)'):
        learned_quantiles(values)


@pytest.mark.parametrize('unfit', [math.nan, math.inf])
def test_cells_that_are_not_finite_are_counted(rng, unfit):
    values = rng.standard_normal(100_003)
    values[[5, 70, 71]] = unfit
    with pytest.raises(ValueError, match=r'^3 of 100003 cells'):
        learned_quantiles(values)


def test_background_is_not_noise(rng):
    with pytest.raises(ValueError, match=r'^the mean [45]'):
        learned_quantiles(5.0 + rng.standard_normal(100_000))


@pytest.mark.parametrize(('values', 'named'), [
    ({'model': 'cauchy'}, 'model'), ({'degrees_of_freedom': 2.0}, 'degrees_of_freedom'),
    ({'shape': 0.0}, 'shape'), ({'background': 0.0}, 'background'),
    ({'quantiles': [math.nan]}, 'quantiles'), ({'model': 'empirical'}, 'quantiles'),
    ({'model': 'empirical', 'quantiles': np.arange(30.0).tolist()}, 'quantiles'),
    ({'model': 'empirical', 'quantiles': [*np.arange(35.0), 34.0]}, 'quantiles'),
])
def test_impossible_parameters_are_rejected_by_name(values, named):
    with pytest.raises(ValueError, match=rf'^Noise\.{named}\b'):
        Noise(**values)
