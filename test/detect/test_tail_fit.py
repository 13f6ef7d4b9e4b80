"""The tail of local maxima: in white noise, by region, and without objects."""

from lowsnr_detect.adaptive.adaptive_threshold import AdaptiveThreshold
from lowsnr_detect.adaptive.local_maxima import local_maxima
from lowsnr_detect.adaptive.region_maps import at_cells
from lowsnr_detect.adaptive.region_maps import bin_quantile
from lowsnr_detect.adaptive.region_maps import log_odds
from lowsnr_detect.adaptive.tail_fit import BINS
from lowsnr_detect.adaptive.tail_fit import bins_of
from lowsnr_detect.adaptive.tail_fit import fitted
from lowsnr_detect.adaptive.tail_fit import levels
from lowsnr_detect.adaptive.white_tail import WhiteTail
import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.ndimage import maximum_filter

# An exponential tail with level 5 and scale 1.
WHITE = WhiteTail(5.0, 1.0, 0.02, 0.0736, tuple((1.0 + 0.25 * np.arange(101)).tolist()))


@pytest.mark.parametrize('reach', [1, 3])
def test_local_maxima_are_those_of_a_maximum_filter(rng, reach):
    plane = rng.standard_normal((23, 31)).astype(np.float32)
    plane[4, 5:9] = -np.inf
    row, col, value = local_maxima(plane, reach)
    wanted = np.nonzero(maximum_filter(plane, 2 * reach + 1) == plane)
    assert np.array_equal(np.stack([row, col]), np.stack(wanted))
    assert np.array_equal(value, plane[row, col])


def test_blank_and_flat_planes_have_no_maximum():
    for value in (0.0, -np.inf):
        assert local_maxima(np.full((5, 7), value, np.float32), 2)[2].size == 0


def test_log_odds_are_those_of_interpolated_thresholds(rng):
    plane, threshold, scale = (
        rng.uniform(1.0, 2.0, size).astype(np.float32) for size in ((30, 40), (3, 2), (3, 2)))
    row, col = np.mgrid[:30, :40]
    places = [np.clip((row + 0.5) / 10 - 0.5, 0, 2), np.clip((col + 0.5) / 20 - 0.5, 0, 1)]
    limit, unit = (map_coordinates(each, places, order=1) for each in (threshold, scale))
    assert log_odds(plane, threshold, scale) == pytest.approx((plane - limit) / unit, abs=1e-5)
    cells = at_cells(threshold, row.ravel(), col.ravel(), (30, 40))
    assert cells == pytest.approx(limit.ravel(), abs=1e-6)


def test_bin_quantile_is_the_quantile_within_a_bin(rng):
    values = rng.gamma(3.0, 5.0, (4, 5000))
    counts = np.stack([np.histogram(each, np.arange(161))[0] for each in values])
    assert bin_quantile(counts, 0.8) == pytest.approx(np.quantile(values, 0.8, axis=1), abs=0.2)


@pytest.mark.parametrize('shape', [1.0, 0.8])
def test_tail_of_a_known_distribution_is_extrapolated(rng, shape):
    # x^(1 / shape) of an exponential x: P(value > t) = exp(-t^shape).
    tail = WhiteTail.of(rng.exponential(size=300_000)**(1.0 / shape), 0.02)
    for prob in (1e-2, 1e-4, 1e-6):
        value = tail.level + tail.scale * tail.excess(np.array(prob / tail.share))
        assert value == pytest.approx((-np.log(prob))**(1.0 / shape), rel=0.12)
        assert tail.survival(tail.excess(np.array(prob))) == pytest.approx(prob, rel=1e-6)


def histogram(values, white=WHITE):
    """Return values (n,) as the counts of a frame with one region."""
    return np.bincount(bins_of(values, white), minlength=BINS)[None, None, None].astype(float)


def test_what_agrees_with_white_noise_is_white_noise_exactly(rng):
    level, scale, known = levels(histogram(5.0 + rng.exponential(size=900) + np.log(0.2)),
                                 WHITE, 1)
    assert (level.item(), scale.item()) == (5.0, 1.0)
    assert known.item() > 1e6


@pytest.mark.parametrize('factor', [0.2, 4.0])
def test_what_differs_is_hardly_shrunk(rng, factor):
    level, scale, known = levels(
        histogram(factor * (9.0 + rng.exponential(size=900) + np.log(0.2))), WHITE, 1)
    assert level.item() == pytest.approx(9.0 * factor, rel=0.1)
    assert scale.item() == pytest.approx(factor, rel=0.3)
    assert 3.0 <= known.item() < 14.0


def test_few_objects_however_bright_hardly_move_a_tail(rng):
    noise = 5.0 + 4.0 * rng.exponential(size=900)
    made = [fitted(histogram(np.concatenate([noise, np.full(10, value)])), 3.0, WHITE, 15_000,
                   0.01, 1) for value in (60.0, 5000.0)]
    thresholds = [(each.level + each.scale * each.excess).item() for each in made]
    assert thresholds[0] == pytest.approx(thresholds[1])


def test_object_is_left_out_and_clutter_everywhere_is_not():
    threshold = AdaptiveThreshold(0.01, WHITE, (32, 32))
    highest = {}
    for crossing in (1, 1000):
        rng, memory = np.random.default_rng(3), threshold.init()
        for _ in range(6):
            plane = rng.uniform(0.0, 4.0, (1, 32, 32)).astype(np.float32)
            plane.reshape(-1)[:crossing] *= 50.0
            memory, _ = threshold.step(memory, plane, threshold.thresholds(memory))
        highest[crossing] = threshold.thresholds(memory).threshold.max()
    assert highest[1] < 20.0
    assert highest[1000] > 150.0
