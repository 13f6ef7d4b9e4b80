# SPDX-License-Identifier: Apache-2.0
"""The contract of a detector, one function for each rule; :data:`CHECKS` lists them."""

from dataclasses import replace

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import POS
from lowsnr_common.settings.flat_values import build_settings
from lowsnr_common.settings.flat_values import flat_values
from lowsnr_detect.calibration.empty_frames import empty_frame_peaks
from lowsnr_detect.calibration.empty_frames import Simulation
from lowsnr_detect.calibration.operating_point import calibrate
from lowsnr_detect.parts.cell_detector import CellDetector
from lowsnr_detect.parts.cell_detector import resolution_of
import numpy as np
import pytest
import scipy.special

SHAPE = (7, 5)
SENSOR = SensorModel(snr_db=9.0)
FEW = {'particles': 400, 'birth_particles': 200}
FIELDS = ('peak', 'score', 'state', 'cov')
EVERYTHING = -1e6
SEED = 3


def make(cls, **settings):
    """Return a detector; a particle filter with few particles."""
    few = {key: value for key, value in FEW.items() if key in cls.__dataclass_fields__}
    return cls(**{'sensor': SENSOR, **few, **settings})


def run(detector, frames, seed=SEED):
    """Return the declarations of frames (K, ..., rows, cols), each frame a fresh array."""
    state, rng = detector.init(frames.shape[1:]), np.random.default_rng(seed)
    answers = []
    for frame in frames:
        state, declared = detector.step(state, frame.copy(), rng)
        answers.append(declared)
    return answers


def noise(*size, seed=SEED):
    """Return frames of noise."""
    return np.random.default_rng(seed).standard_normal((*size, *SHAPE))


def bytes_of(answers):
    """Return declarations as bytes."""
    return [getattr(answer, name).tobytes() for answer in answers for name in FIELDS]


def same_seed_gives_same_bytes(cls):
    detector, frames = make(cls, threshold=2.0), noise(8, 2)
    assert bytes_of(run(detector, frames)) == bytes_of(run(detector, frames))


def frames_are_not_changed(cls):
    detector, frame = make(cls), noise()
    kept = frame.copy()
    detector.step(detector.init(SHAPE), frame, np.random.default_rng(SEED))
    assert np.array_equal(frame, kept)


def memory_is_not_changed(cls):
    detector, frames = make(cls, threshold=1.0), noise(4)
    state = detector.init(SHAPE)
    for frame in frames:
        one, other = (
            detector.step(state, frame, np.random.default_rng(SEED)) for _ in range(2))
        assert bytes_of([one[1]]) == bytes_of([other[1]])
        state = one[0]


def batch_equals_single_runs(cls):
    if {'particles'} & set(cls.__dataclass_fields__):
        return  # draws random numbers for the batch as a whole
    detector, frames = make(cls, threshold=2.0), noise(8, 2, 3)
    batch = run(detector, frames)
    for index in np.ndindex(2, 3):
        single = run(detector, frames[(slice(None), *index)])
        for one, other in zip(single, batch, strict=True):
            for name in FIELDS:
                # The products of matrices may add in another order.
                assert getattr(one, name) == pytest.approx(
                    getattr(other, name)[index], rel=1e-9, abs=1e-9, nan_ok=True)


def shapes_follow_the_frame(cls):
    for lead in ((), (2,), (2, 3)):
        for threshold in (EVERYTHING, 1e6):
            declared = run(make(cls, threshold=threshold), noise(2, *lead))[-1]
            slots = declared.score.shape[-1]
            assert declared.peak.shape == lead
            assert declared.score.shape == (*lead, slots)
            assert declared.state.shape == (*lead, slots, 4)
            assert declared.cov.shape == (*lead, slots, 4, 4)
            assert np.all(declared.any == (threshold == EVERYTHING)) or cls.feedback


def slots_are_sorted_and_the_unused_ones_empty(cls):
    for declared in run(make(cls, threshold=1.0), noise(12, 20)):
        used = declared.score > 0.0
        assert np.array_equal(declared.any, declared.peak > 1.0)
        assert np.all(declared.score[used] <= 1.0)
        assert np.all(np.diff(declared.score, axis=-1) <= 0.0)
        assert np.isnan(declared.state[~used]).all()
        assert np.isnan(declared.cov[~used]).all()
        position = declared.state[used][:, [0, 2]]
        assert np.all((position > -0.5) & (position < np.array(SHAPE[::-1]) - 0.5))
        cov = declared.cov[used][:, [0, 2]][:, :, [0, 2]]
        assert np.all(np.linalg.eigvalsh(cov) > 0.0)
        whole = np.isfinite(declared.state[used]).all(axis=-1)
        assert np.all(np.linalg.eigvalsh(declared.cov[used][whole]) > -1e-12)


def false_alarms_are_at_the_calibrated_probability(cls):
    prob, runs, frames = 0.05, 100, 20
    detector = make(cls)
    found = calibrate(detector, prob, SHAPE, runs=runs, frames=frames)
    tuned = replace(detector, threshold=found.threshold)
    peaks = empty_frame_peaks(tuned, Simulation(runs, frames, SHAPE, SEED))
    alarms = (peaks > found.threshold).mean(axis=1)
    # Frames of a run depend on each other, so that the runs are counted; the threshold comes
    # from as many, hence the 2.  Four standard errors.
    assert abs(alarms.mean() - prob) < 4.0 * alarms.std() * np.sqrt(2.0 / runs)


def bright_object_is_found_where_it_is(cls):
    for blur in (0.0, 0.6):
        sensor = SensorModel(snr_db=24.0 if blur else 18.0, blur_m=blur, cell_size_m=2.0)
        errors_m = []
        # A detector may be made for objects that stand, or for those that move.
        for speed in (0.0, 1.0):
            truth = np.array([[2.0, 0.0, 10.0 - (9 - k) * speed, speed] for k in range(10)])
            frames = noise(10) + np.stack([sensor.signal(state, SHAPE) for state in truth])
            declared = run(make(cls, sensor=sensor, threshold=3.0), frames)[-1]
            errors_m.append(np.hypot(*(declared.state[0, [0, 2]] - truth[-1, [0, 2]])))
        assert np.nanmin(errors_m) < 2.0


def first_frame_may_hold_the_object(cls):
    frame = np.zeros((1, *SHAPE))
    frame[0, 4, 1] = 9.0
    (declared,) = run(make(cls, threshold=EVERYTHING), frame)
    assert declared.any or declared.peak == -np.inf


def blank_frames_declare_nothing(cls):
    answers = run(make(cls, threshold=1.0), np.zeros((10, *SHAPE)))
    assert not any(declared.any for declared in answers)


def outliers_leave_numbers_and_are_forgotten(cls):
    frames = noise(60)
    frames[8:] = 0.0
    frames[4, 6, 4] = frames[5, 0, 0] = 1e6
    answers = run(make(cls, threshold=6.0), frames)
    for declared in answers:
        assert not np.isnan(declared.peak)
        assert np.isfinite(declared.state[declared.score > 0.0][:, [0, 2]]).all()
    assert not any(declared.any for declared in answers[-5:])


def smallest_frames_leave_numbers(cls):
    for shape in ((1, 1), (1, 4), (3, 1)):
        frames = np.random.default_rng(SEED).standard_normal((4, *shape))
        assert not any(np.isnan(it.peak).any() for it in run(make(cls), frames))


def settings_build_an_equal_detector(cls):
    detector = make(cls)
    again = build_settings(cls, flat_values(detector))
    assert again == detector
    assert hash(again) == hash(detector)


def nominal_differs_in_thresholds_only(cls):
    nominal = make(cls, threshold=7.7).nominal()
    assert type(nominal) is cls
    changed = {key for key, value in flat_values(nominal).items()
               if flat_values(make(cls, threshold=7.7))[key] != value}
    assert 'threshold' in changed
    assert all(key.endswith('threshold') for key in changed)


def frames_per_declaration_is_a_count(cls):
    assert isinstance(make(cls).frames_per_declaration, int)
    assert make(cls).frames_per_declaration >= 1


def declarations_are_farther_apart_than_the_resolution(cls):
    # Centroids are moved afterwards.
    cells = type(cls.__name__, (cls,), {'centroid_reach': 0})
    detector = make(cells, threshold=-1.0)
    most = 0
    for declared in run(detector, noise(12)):
        place = declared.state[declared.score > 0.0][:, POS]
        apart = abs(place[:, None] - place).max(axis=-1)
        assert np.all(apart[~np.eye(len(place), dtype=bool)] > resolution_of(detector))
        most = max(most, len(place))
    assert most > 1 or not isinstance(detector, CellDetector)


def statistic_does_not_depend_on_the_most_declarations(cls):
    # The calibration makes only one in a frame.
    settings = [{'max_detections': most} for most in (1, 50)]
    if 'max_detections' in cls.__dataclass_fields__:
        one, many = (
            [it.peak for it in run(make(cls, threshold=-1.0, **each), noise(12, 2))]
            for each in settings)
        assert np.array_equal(one, many)


def map_is_the_statistic_minus_the_threshold(cls):
    """One of cells has it as its largest value, one of an object as its sum, as odds."""
    threshold, frames = 1.0, noise(8, 30)
    detector = make(cls, threshold=threshold)
    state, rng = detector.init(frames.shape[1:]), np.random.default_rng(SEED)
    for frame in frames:
        before, (state, declared) = state, detector.step(state, frame, rng)
        plane = detector.statistic_map(before, frame, state)
        assert plane.shape == frame.shape
        over = plane.max(axis=(1, 2)) if cls.local else scipy.special.logsumexp(plane, (1, 2))
        if 'particles' in cls.__dataclass_fields__:  # resampled: five standard deviations
            found, weighed = map(scipy.special.expit, (over + threshold, declared.peak))
            std = np.sqrt(weighed * (1.0 - weighed) / FEW['particles'])
            assert np.all(abs(found - weighed) <= 5.0 * std + 1.001 / FEW['particles'])
            continue
        assert np.array_equal(over > 0.0, declared.any)
        assert over[declared.any] == pytest.approx(
            declared.peak[declared.any] - threshold, abs=1e-4)


CHECKS = (
    same_seed_gives_same_bytes, frames_are_not_changed, memory_is_not_changed,
    batch_equals_single_runs, shapes_follow_the_frame,
    slots_are_sorted_and_the_unused_ones_empty, false_alarms_are_at_the_calibrated_probability,
    bright_object_is_found_where_it_is, first_frame_may_hold_the_object,
    blank_frames_declare_nothing, outliers_leave_numbers_and_are_forgotten,
    smallest_frames_leave_numbers, settings_build_an_equal_detector,
    nominal_differs_in_thresholds_only, frames_per_declaration_is_a_count,
    declarations_are_farther_apart_than_the_resolution,
    statistic_does_not_depend_on_the_most_declarations,
    map_is_the_statistic_minus_the_threshold)
