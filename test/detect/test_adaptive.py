# SPDX-License-Identifier: Apache-2.0
"""Adaptive thresholds: the rate they hold in noise of any kind, and what they still detect."""

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_detect.adaptive.adaptive_detector import AdaptiveDetector
from lowsnr_detect.adaptive.adaptive_threshold import LEARNING_FRAMES
from lowsnr_detect.detectors.auto import Auto
from lowsnr_detect.detectors.cusum import CUSUM
from lowsnr_detect.detectors.hmm import HMM
from lowsnr_detect.node.live_detector import LiveDetector
from lowsnr_detect.parts.registry import detector_class
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

SENSOR = SensorModel(snr_db=8.0)
NAMES = ('cdt', 'sdt', 'cusum', 'bank', 'auto')


def shares(name, frames, rng, prob=0.01):
    """Return whether each frame (K, runs, rows, cols) after the ninth holds a declaration."""
    detector = AdaptiveDetector(detector_class(name)(sensor=SENSOR), prob, frames.shape[2:])
    state, answers = detector.init(frames.shape[1:]), []
    for frame in frames:
        state, declared = detector.step(state, frame, rng)
        answers.append(declared.any)
    return np.stack(answers)[9:], detector.measured(state)


@pytest.mark.parametrize('name', NAMES)
def test_white_noise_holds_the_rate(rng, name):
    # 120 runs of 21 frames that depend on each other over three: four standard errors are .014.
    declared, measured = shares(name, rng.standard_normal((30, 120, 20, 20)), rng)
    assert 0.0 < declared.mean() < 0.024
    assert 0.0 < measured < 0.024


@pytest.mark.parametrize('name', NAMES)
def test_map_is_above_zero_where_a_cell_is_declared(rng, name):
    detector = AdaptiveDetector(detector_class(name)(sensor=SENSOR), 0.2, (20, 18))
    state, some = detector.init((6, 20, 18)), 0
    for frame in rng.standard_normal((25, 6, 20, 18)):
        before, (state, declared) = state, detector.step(state, frame, rng)
        most = detector.statistic_map(before, frame, state).max(axis=(1, 2))
        assert np.array_equal(most > 0.0, declared.any)
        assert most[declared.any] == pytest.approx(declared.peak[declared.any])
        some += declared.any.sum()
    assert some > 5


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
    assert threshold[:, -1].min() > 4.0 * threshold[:, 0].max()


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


@pytest.mark.parametrize(('objects', 'first'), [(1, 0), (4, 10), (12, 10)])
def test_objects_are_found_one_from_the_start_and_many_later(rng, objects, first):
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


@pytest.mark.parametrize('name', ['sdt', 'cusum', 'auto'])
def test_an_object_is_found_where_it_is_the_only_maximum_of_small_frames(rng, name):
    frames = rng.standard_normal((30, 10, 10, 10))
    column = np.rint(2.0 + 0.2 * np.arange(30)).astype(int)
    frames[np.arange(5, 30), :, 4, column[5:]] += 5.0
    detector = AdaptiveDetector(detector_class(name)(), 0.01, (10, 10))
    state, hits = detector.init((10, 10, 10)), []
    for k, frame in enumerate(frames):
        state, declared = detector.step(state, frame, rng)
        away = np.linalg.norm(declared.state[..., [2, 0]] - (4, column[k]), axis=-1)
        hits.append(np.any(away <= 1.5, axis=-1))
    assert np.mean(hits[12:]) > 0.85


@pytest.mark.parametrize('name', ['sdt', 'cusum'])
def test_small_frames_of_white_noise_hold_the_rate(rng, name):
    # 300 runs of 21 frames that depend on each other over three: four standard errors are .009.
    declared, _ = shares(name, rng.standard_normal((30, 300, 10, 10)), rng)
    assert 0.0 < declared.mean() < 0.019


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
