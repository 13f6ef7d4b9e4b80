# SPDX-License-Identifier: Apache-2.0
"""The tail of a statistic: white noise where the maxima agree with it, and data where not."""

from lowsnr_common.core.measurement import SensorModel
from lowsnr_detect.adaptive.adaptive_threshold import AdaptiveThreshold
from lowsnr_detect.adaptive.adaptive_threshold import LEARNING_FRAMES
from lowsnr_detect.adaptive.known_tails import white_tail
from lowsnr_detect.adaptive.tail_fit import BINS
from lowsnr_detect.adaptive.tail_fit import bins_of
from lowsnr_detect.adaptive.tail_fit import levels
from lowsnr_detect.adaptive.tail_fit import made_up
from lowsnr_detect.adaptive.white_tail import WhiteTail
from lowsnr_detect.detectors.cdt import CDT
from lowsnr_detect.detectors.cusum import CUSUM
import numpy as np
import pytest

# Of exponential maxima: level ln 5, scale 1, and exp(-1) of the fifth above the level beyond 1.
LEVEL, SHARE = np.log(5.0), 0.2 / np.e


@pytest.fixture(scope='module')
def exponential():
    """Return the tail of a hundred thousand exponential maxima, a tenth of them a cell."""
    return WhiteTail.of(np.random.default_rng(5).exponential(size=100_000), 0.1)


def test_tail_of_exponential_maxima_is_the_closed_form(exponential):
    assert exponential.level == pytest.approx(LEVEL, abs=0.03)
    assert exponential.scale == pytest.approx(1.0, abs=0.03)
    assert exponential.share == pytest.approx(SHARE, rel=0.05)
    rarity = np.array([0.0, 1.0, 3.0, 6.0])
    np.testing.assert_allclose(exponential.excess(rarity), 1.0 + rarity, atol=0.5)
    np.testing.assert_allclose(exponential.rarity(exponential.excess(rarity)), rarity, atol=1e-9)


def test_rarities_beyond_the_known_ones_are_extrapolated(exponential):
    known, beyond = exponential.excess(np.array([25.0, 40.0]))
    assert beyond - known == pytest.approx(15.0, rel=0.3)


@pytest.mark.parametrize('prob', [0.001, 0.01, 0.3])
def test_threshold_of_white_noise_is_that_of_the_largest_of_many(exponential, prob):
    # A frame of 1,000 cells has 100 maxima on average: P(none above x) = exp(-100 exp(-x)).
    wanted = -np.log(-np.log1p(-prob) / 100.0)
    assert exponential.threshold(1000, prob) == pytest.approx(wanted, abs=0.5)


def counted(white, maxima, grid=(1, 1)):
    """Return the histogram (1, R, C, bins) of as many maxima in each region."""
    counts = np.bincount(bins_of(maxima, white), minlength=BINS).astype(float)
    return np.broadcast_to(counts, (1, *grid, BINS))


def test_share_of_maxima_below_a_value_is_the_closed_form(exponential):
    value = np.array([0.3, 0.7, 1.6, 2.3, 3.0, 5.0])
    np.testing.assert_allclose(exponential.below(value), -np.expm1(-value), atol=0.01)


def test_few_maxima_are_made_up_to_forty_of_white_noise(exponential):
    none = np.zeros((2, 1, 2, BINS))
    some = np.concatenate([counted(exponential, np.full(30, 2.0)), np.zeros((1, 1, 1, BINS))])
    filled = made_up(none, exponential)
    np.testing.assert_allclose(filled.sum(axis=-1), 20.0)
    found = levels(none, exponential, 1)
    np.testing.assert_allclose(found.level, exponential.level, rtol=1e-9)
    np.testing.assert_allclose(found.scale, exponential.scale, rtol=1e-9)
    assert made_up(some, exponential).sum(axis=(1, 2, 3)) == pytest.approx([40.0, 40.0])
    enough = counted(exponential, np.full(40, 2.0))
    assert made_up(enough, exponential) is enough


def test_levels_of_white_noise_are_its_own_exactly(exponential, rng):
    exact = 0
    for _ in range(100):
        found = levels(counted(exponential, rng.exponential(size=200)), exponential, 1)
        exact += bool(found.level == exponential.level and found.scale == exponential.scale)
    # Two numbers of a frame and of its only region, which chi-squared exceeds with 5 %.
    assert exact >= 85


def test_levels_that_clearly_differ_are_those_of_the_data(exponential, rng):
    found = levels(counted(exponential, 3.0 * rng.exponential(size=4000)), exponential, 1)
    assert found.level == pytest.approx(3.0 * LEVEL, rel=0.1)
    assert found.scale == pytest.approx(3.0, rel=0.15)
    # 800 excesses, of which the median is as good as ln(2)^2 times as many.
    assert 300.0 < found.known.item() < 800.0


def test_few_maxima_that_differ_a_little_are_white_noise(exponential, rng):
    found = levels(counted(exponential, 1.3 * rng.exponential(size=30)), exponential, 1)
    assert found.level == exponential.level
    assert found.scale == exponential.scale


def test_no_threshold_is_below_that_in_white_noise(rng):
    detector = CDT(sensor=SensorModel(snr_db=8.0))
    tail = AdaptiveThreshold(0.01, white_tail(detector, 32, 32), (32, 32), 1, 1)
    memory = tail.init(1)
    for _ in range(20):
        quiet = 0.2 * rng.standard_normal((1, 32, 32))
        memory, _ = tail.step(memory, detector.statistic(None, quiet)[1].astype(np.float32))
    at = tail.thresholds(memory)
    assert at.level.max() < tail.white.level - 1.0
    assert at.threshold.min() == pytest.approx(tail.start, rel=1e-5)


@pytest.mark.parametrize(('level', 'silent'), [(0.0, False), (0.8, True)])
def test_statistic_that_needs_white_noise_is_silent_without_it(rng, level, silent):
    detector = CUSUM(sensor=SensorModel(snr_db=8.0), threshold=13.0)
    tail = AdaptiveThreshold(
        0.01, white_tail(detector, 48, 64), (48, 64), detector.peak_reach, 3, only_white=True)
    memory, state = tail.init(1), detector.init((1, 48, 64))
    stays = level * rng.standard_normal((1, 48, 64))
    for _ in range(LEARNING_FRAMES + 6):
        frame = np.sqrt(1.0 - level**2) * rng.standard_normal((1, 48, 64)) + stays
        frame[0, 20, 20] = 8.0
        state, plane = detector.statistic(state, frame)
        memory, odds = tail.step(memory, plane)
    assert (odds.max() == -np.inf) == silent
