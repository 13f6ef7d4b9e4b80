"""Adaptive thresholds: the rate they hold in noise of any kind, and what they still detect."""

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_detect.adaptive.adaptive_detector import AdaptiveDetector
from lowsnr_detect.adaptive.adaptive_threshold import AdaptiveThreshold
from lowsnr_detect.adaptive.adaptive_threshold import LEARNING_FRAMES
from lowsnr_detect.adaptive.local_maxima import local_maxima
from lowsnr_detect.adaptive.region_maps import at_cells
from lowsnr_detect.adaptive.region_maps import bin_quantile
from lowsnr_detect.adaptive.region_maps import log_odds
from lowsnr_detect.adaptive.tail_fit import BINS
from lowsnr_detect.adaptive.tail_fit import bins_of
from lowsnr_detect.adaptive.tail_fit import fitted
from lowsnr_detect.adaptive.tail_fit import levels
from lowsnr_detect.adaptive.white_tail import WhiteTail
from lowsnr_detect.detectors.auto import Auto
from lowsnr_detect.detectors.cusum import CUSUM
from lowsnr_detect.detectors.hmm import HMM
from lowsnr_detect.node.live_detector import LiveDetector
from lowsnr_detect.parts.registry import detector_class
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.ndimage import map_coordinates
from scipy.ndimage import maximum_filter

SENSOR = SensorModel(snr_db=8.0)
# An exponential tail with level 5 and scale 1.
WHITE = WhiteTail(5.0, 1.0, 0.02, 0.0736, tuple((1.0 + 0.25 * np.arange(101)).tolist()))
NAMES = ('cdt', 'sdt', 'cusum', 'bank', 'auto')


def shares(name, frames, rng, prob=0.01):
    """Return whether each frame (K, runs, rows, cols) after the ninth holds a declaration."""
    detector = AdaptiveDetector(detector_class(name)(sensor=SENSOR), prob, frames.shape[2:])
    state, answers = detector.init(frames.shape[1:]), []
    for frame in frames:
        state, declared = detector.step(state, frame, rng)
        answers.append(declared.any)
    return np.stack(answers)[9:], detector.measured(state)


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


@pytest.mark.parametrize('name', NAMES)
def test_white_noise_holds_the_rate(rng, name):
    # 100 runs of 25 frames that depend on each other over three: three standard errors are .010.
    declared, measured = shares(name, rng.standard_normal((34, 100, 20, 20)), rng)
    assert 0.001 < declared.mean() < 0.019
    assert 0.0 < measured < 0.019


@pytest.mark.parametrize('name', ['cusum', 'bank', 'auto'])
def test_coloured_noise_holds_the_rate_where_a_simulated_threshold_does_not(rng, name):
    frames = np.empty((50, 6, 64, 96))
    frames[0] = rng.standard_normal((6, 64, 96))
    # Lag-1 correlation .6 in time, three times the noise in a third of the frame.
    for k in range(1, 50):
        frames[k] = 0.6 * frames[k - 1] + 0.8 * rng.standard_normal((6, 64, 96))
    frames[..., 64:] *= 3.0
    declared, _ = shares(name, frames, rng)
    plain = detector_class(name)(sensor=SENSOR, threshold=14.0)
    state = plain.init((6, 64, 96))
    for frame in frames:
        state, answer = plain.step(state, frame, rng)
    assert answer.any.all()
    assert declared.mean() < 0.05


def test_regions_have_thresholds_of_their_own(rng):
    frames = rng.standard_normal((30, 1, 64, 192))
    frames[..., 96:] *= 3.0
    detector = AdaptiveDetector(detector_class('bank')(sensor=SENSOR), 0.01, (64, 192))
    state = detector.init((1, 64, 192))
    for frame in frames:
        state, _ = detector.step(state, frame, rng)
    threshold = detector.tails[0].thresholds(state.tails[0]).threshold[0]
    # u^2 / 2 of three times the noise is nine times as large (eight sigma are the limit).
    assert threshold[:, 6:].min() > 5.0 * threshold[:, :2].max()


def scene(rng, objects, first, frames=40, shape=(64, 64)):
    """Return frames of blurred noise with objects of six sigma from one on, and their places."""
    start = rng.uniform(4.0, 60.0, (objects, 2))
    heading = rng.uniform(0.0, 2.0 * np.pi, objects)
    step = rng.uniform(0.2, 0.9, objects)[:, None] * np.stack(
        [np.sin(heading), np.cos(heading)], -1)
    place = start + step * np.arange(frames)[:, None, None]
    cells = np.rint(place).astype(int)
    images = gaussian_filter(rng.standard_normal((frames, *shape)), (0, 0.5, 0.5))
    images /= images.std()
    for image, found in zip(images[first:], cells[first:]):
        inside = ((found >= 0) & (found < shape)).all(axis=1)
        image[tuple(found[inside].T)] += 6.0
    return images, place


@pytest.mark.parametrize(('objects', 'first'), [(1, 0), (4, 10)])
def test_objects_are_found_one_from_the_start_and_some_later(rng, objects, first):
    hits = present = false = scored = 0
    for _ in range(3):
        images, place = scene(rng, objects, first)
        detector = AdaptiveDetector(Auto(sensor=SENSOR), 0.01, (64, 64))
        state = detector.init((64, 64))
        for k, image in enumerate(images):
            state, declared = detector.step(state, image, rng)
            if k < first + 9:
                continue
            found = declared.state[declared.score > 0.0][:, [2, 0]]
            inside = ((place[k] >= 1) & (place[k] < 63)).all(axis=1)
            gap = np.linalg.norm(found[:, None] - place[k], axis=-1)
            hits += np.sum((gap.min(axis=0, initial=np.inf) <= 2.0) & inside)
            present, scored = present + inside.sum(), scored + 1
            false += np.sum(gap.min(axis=1, initial=np.inf) > 6.0)
    assert hits / present > 0.8
    assert false / scored < 0.1


def test_first_frames_are_not_answered_and_blank_ones_not_counted(rng):
    detector = AdaptiveDetector(CUSUM(sensor=SENSOR), 0.01, (20, 24))
    state, answers = detector.init((20, 24)), []
    for k in range(12):
        frame = np.zeros((20, 24)) if k < 4 else rng.standard_normal((20, 24))
        frame[10, 12] += 40.0 * (k >= 4)
        state, declared = detector.step(state, frame, rng)
        answers.append(bool(declared.any))
    assert answers == [False] * (4 + LEARNING_FRAMES) + [True] * (8 - LEARNING_FRAMES)
    assert state.tails[0].frames == 8


def test_memory_is_not_changed(rng):
    detector = AdaptiveDetector(Auto(sensor=SENSOR), 0.05, (20, 24))
    state = detector.init((20, 24))
    for _ in range(8):
        frame = rng.standard_normal((20, 24))
        one, first = detector.step(state, frame, rng)
        _, second = detector.step(state, frame, rng)
        assert first.peak == second.peak
        state = one


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


def test_detector_without_a_statistic_of_cells_is_refused():
    with pytest.raises(ValueError, match="HMM.*'adaptive'"):
        AdaptiveDetector(HMM(), 0.01, (8, 8))


def live(name, point, **settings):
    """Return a live detector at an operating point, and what it logs."""
    logged = []
    operating = DetectionSettings(operating_point=point, false_alarm_prob=0.05)
    detector = detector_class(name)(sensor=SENSOR, **settings)
    return LiveDetector(name, (detector, operating), (20, 24), logged.append), logged


def test_node_states_the_rate_asked_and_measured_and_starts_without_a_curve(rng, monkeypatch):
    monkeypatch.setattr('lowsnr_detect.node.live_detector.curve', None)
    work, _ = live('auto', 'adaptive')
    for _ in range(30):
        work.step(rng.standard_normal((20, 24)), rng)
    assert 0.0 <= work.measured() < 0.3
    assert 5.0 < work.thresholds()['threshold'] < 100.0


def test_operating_point_changes_to_adaptive_and_back_with_an_empty_memory(rng):
    work, logged = live('cusum', 'manual', threshold=9.0)
    detector = CUSUM(sensor=SENSOR, threshold=9.0)
    for number, point in enumerate(('adaptive', 'manual')):
        work.step(rng.standard_normal((20, 24)), rng)
        settings = (detector, DetectionSettings(operating_point=point))
        work.check(settings)
        work.change(settings, number)
        assert (work.measured() is None) == (point == 'manual')
    work.step(rng.standard_normal((20, 24)), rng)
    assert work.thresholds() == {'threshold': 9.0}
    assert [line.rpartition(', ')[2] for line in logged] == ['memory starts empty'] * 2


def test_change_to_adaptive_is_refused_without_a_statistic_of_cells():
    work, _ = live('hmm', 'manual')
    with pytest.raises(ValueError, match='HMM'):
        work.check((HMM(), DetectionSettings(operating_point='adaptive')))
