# SPDX-License-Identifier: Apache-2.0
"""The compiled loops over cells compute what their definitions in NumPy do."""

from dataclasses import replace
import tracemalloc

from lowsnr_common.core import compiled
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_detect.detectors.bernoulli import Bernoulli
from lowsnr_detect.detectors.cusum import CUSUM
from lowsnr_detect.detectors.cusum import page_recursion
from lowsnr_detect.detectors.hmm import forward
from lowsnr_detect.detectors.hmm import HMM
from lowsnr_detect.detectors.pmf import PMF
from lowsnr_detect.detectors.sdt import SDT
from lowsnr_detect.detectors.sdt import sequential_test
from lowsnr_detect.grid.grid_filter import move_and_weigh
from lowsnr_detect.node.live_detector import LiveDetector
from lowsnr_detect.node.warm_up import warm_up
from lowsnr_detect.parts.cell_detector import CellDetector
from lowsnr_detect.parts.moves import best_vicinity
from lowsnr_detect.parts.moves import move_model
from lowsnr_detect.parts.moves import shifted
from lowsnr_detect.parts.registry import detector_class
from lowsnr_detect.parts.registry import DETECTORS
from lowsnr_detect.parts.wald_bounds import floor32
from lowsnr_detect.parts.wald_bounds import ratio_terms
from lowsnr_detect.parts.wald_bounds import wald_bounds
import numpy as np
import pytest

SENSOR = SensorModel(snr_db=4.0, noise_std=1.3)
SHAPES = [(1, 1), (1, 9), (9, 1), (23, 17), (70, 33), (2, 3, 19, 5)]


def ratio_of(frame, sensor=SENSOR):
    """Return the log ratios of a frame as the detectors have them, in float32."""
    plane, factor, offset = ratio_terms(sensor, frame)
    return (plane.astype(np.float32) * factor - offset).reshape(frame.shape)


SETTINGS = [
    {}, {'radius': 0}, {'radius': 2}, {'radius': 3}, {'restart': 'unused'},
    {'restart': 'unused', 'radius': 2}, {'upper_threshold': 3.0}, {'max_iterations': 1},
    {'max_iterations': 2, 'upper_threshold': 1.5, 'restart': 'unused'},
    {'threshold': 3.0, 'upper_threshold': 1.0}]


def step_both(detector, frames):
    """Yield log ratios of the open paths and of the decided ones: defined, and compiled."""
    sensor, s_m, shape = detector.sensor, detector.max_iterations, frames.shape[1:]
    T, state = np.full((s_m - 1, *shape), -np.inf), detector.init(shape)
    M = np.arange(1, s_m).reshape(-1, *[1] * len(shape))
    gain = sensor.intensity / sensor.noise_std**2
    ln_th = wald_bounds(detector.alpha, detector.beta)[0], detector.upper_threshold
    for frame in frames:
        T, decided = sequential_test(
            T, frame, sensor, ln_th, detector.threshold, detector.radius, detector.restart)
        state, declared = detector.step(state, frame, None)
        yield (gain * (T - M * sensor.intensity / 2.0), decided.max(axis=(-2, -1)),
               state.log_ratio, declared)


@pytest.mark.parametrize('shape', SHAPES)
@pytest.mark.parametrize('settings', SETTINGS)
def test_sdt_is_its_definition_to_the_bit_where_float32_does_not_round(rng, shape, settings):
    # I = sigma = 2 and measurements in 64ths: T_M and ln L_M have few binary digits.
    sensor = SensorModel(snr_db=0.0, noise_std=2.0)
    detector = SDT(**{'sensor': sensor, 'alpha': 0.1, 'beta': 0.1, 'threshold': 1.1, **settings})
    frames = np.rint(64.0 * (2.0 * rng.standard_normal((7, *shape)) + 0.7)) / 64.0
    declares = 0
    for paths, peak, log_ratio, declared in step_both(detector, frames):
        assert np.array_equal(log_ratio, paths)
        assert np.array_equal(declared.peak, peak)
        declares += np.count_nonzero(declared.any)
    assert declares > 0 or np.prod(shape) < 20


@pytest.mark.parametrize('snr_db', [-3.0, 4.0, 9.0])
@pytest.mark.parametrize('settings', SETTINGS)
def test_sdt_is_its_definition_within_the_rounding_of_float32(rng, snr_db, settings):
    sensor = SensorModel(snr_db=snr_db, noise_std=1.3)
    detector = SDT(**{'sensor': sensor, 'alpha': 0.1, 'beta': 0.1, 'threshold': 1.1, **settings})
    frames = 1.3 * rng.standard_normal((9, 3, 23, 17)) + 0.5
    for paths, peak, log_ratio, declared in step_both(detector, frames):
        # Six additions of numbers up to 32, each rounded to 24 binary digits.
        np.testing.assert_allclose(log_ratio, paths, rtol=0.0, atol=2e-5)
        np.testing.assert_allclose(declared.peak, peak, rtol=0.0, atol=2e-5)


@pytest.mark.parametrize('shape', SHAPES)
@pytest.mark.parametrize('speed', [1.0, 1.8])
def test_best_move_is_that_of_shifted_planes_to_the_bit(rng, shape, speed):
    model = move_model(MotionModes(max_speed_mps=speed), SENSOR, 0)
    log_prob = np.log(model.kernel.ravel()).astype(np.float32)
    by_cell = log_prob[:, None, None] + rng.random(shape[-2:]).astype(np.float32)
    for plane in (rng.standard_normal(shape), rng.standard_normal(shape).astype(np.float32)):
        for given in (log_prob, by_cell):
            expected = np.max([
                shifted(plane + one.astype(plane.dtype), move, -np.inf)
                for move, one in zip(model.moves, given)], axis=0)
            assert np.array_equal(best_vicinity(plane, model.moves, given), expected)


@pytest.mark.parametrize('shape', SHAPES)
@pytest.mark.parametrize(('drift', 'headroom'), [(0.0, 10.0), (0.25, 1.0)])
def test_cusum_is_its_definition_to_the_bit(rng, shape, drift, headroom):
    detector = CUSUM(sensor=SENSOR, drift=drift, threshold=3.0, headroom=headroom)
    model, state = move_model(detector.motion, SENSOR, 0), detector.init(shape)
    log_prob = np.log(model.kernel.ravel()).astype(np.float32)
    for _ in range(8):
        frame = 1.3 * rng.standard_normal(shape) + 0.5
        expected = page_recursion(
            state, ratio_of(frame), model.moves, log_prob, np.float32(drift),
            np.float32(3.0 + headroom))
        state, _ = detector.step(state, frame, None)
        assert np.array_equal(state, expected)


@pytest.mark.parametrize('shape', SHAPES)
@pytest.mark.parametrize(('order', 'speed'), [(0, 1.0), (1, 1.0), (2, 1.0), (0, 1.8), (1, 1.8)])
def test_hmm_is_its_definition(rng, shape, order, speed):
    model = move_model(MotionModes(max_speed_mps=speed), SENSOR, order)
    belief = rng.random((*model.history.shape, *shape))
    weight, stays, born = rng.random(shape), rng.random(shape[:-2]), rng.random(shape[:-2])
    none, one = np.zeros(shape[:-2]), np.ones(shape[:-2])
    expected = forward(model, belief, weight, stays, born)
    moved = forward(model, belief, np.ones(shape), one, none)
    found, inside, mass = move_and_weigh(model, belief, weight, stays, born)
    np.testing.assert_allclose(found, expected, rtol=1e-13)
    np.testing.assert_allclose(inside, moved.sum(axis=(0, 1, -2, -1)), rtol=1e-13)
    np.testing.assert_allclose(mass, expected.sum(axis=(0, 1, -2, -1)), rtol=1e-13)


@pytest.mark.parametrize('detector', [
    SDT(), SDT(restart='unused', radius=2), SDT(move_prior=True), CUSUM(), HMM(order=0),
    HMM(order=1), PMF(headings=8), Bernoulli()])
@pytest.mark.parametrize('regions', [2, 3, 64])
def test_regions_give_the_same_bits(rng, detector, regions):
    whole = replace(detector, sensor=SENSOR, threshold=4.0)
    parts, frames = replace(whole, regions=regions), 1.3 * rng.standard_normal((6, 2, 77, 19))
    one, other = whole.init((2, 77, 19)), parts.init((2, 77, 19))
    for frame in frames:
        one, expected = whole.step(one, frame, None)
        other, found = parts.step(other, frame, None)
        for name in ('peak', 'score', 'state', 'cov'):
            assert np.array_equal(getattr(found, name), getattr(expected, name), equal_nan=True)


@pytest.mark.parametrize('bound', [0.0, 1.1, -1.1, 4.605, -9.21, 1e-40, 1e30])
def test_bound_in_float32_compares_as_the_bound_does(bound):
    near, most = floor32(bound), np.float32(np.inf)
    for value in (np.nextafter(near, -most), near, np.nextafter(near, most), np.float32(bound)):
        assert (value > near) == (float(value) > bound)


@pytest.mark.parametrize('bound', [1e300, np.inf])
def test_bound_beyond_float32_is_never_exceeded(bound):
    assert not np.float32(3e38) > floor32(bound)
    assert np.float32(-3e38) > floor32(-bound)


@pytest.mark.parametrize('kind', [np.float32, np.float64])
@pytest.mark.parametrize(('name', 'point'), [
    (name, point) for name in sorted(DETECTORS) for point in ('manual', 'adaptive')
    if point == 'manual' or issubclass(detector_class(name), CellDetector)])
def test_nothing_is_compiled_after_the_warm_up(rng, name, kind, point):
    few = {'particles': 100, 'birth_particles': 50}
    cls = detector_class(name)
    detector = cls(threshold=1.0, **{k: v for k, v in few.items() if hasattr(cls, k)})
    settings = detector, DetectionSettings(operating_point=point)
    warm_up(*settings)
    before = compiled.variants()
    work = LiveDetector(name, settings, (23, 57), lambda _: None)
    for _ in range(60):
        work.step((rng.standard_normal((23, 57)) + 0.4).astype(kind), rng)
    assert compiled.variants() == before


@pytest.mark.parametrize(('detector', 'planes', 'size'), [
    (SDT(threshold=50.0), 4, 4), (CUSUM(threshold=50.0), 1, 4), (HMM(order=0), 1, 8),
    (HMM(order=1), 9, 8), (Bernoulli(threshold=10.0), 11, 8)])
def test_detector_holds_at_most_three_times_its_planes(rng, detector, planes, size):
    frames = rng.standard_normal((3, 200, 200))
    warm_up(detector, DetectionSettings(operating_point='manual'))
    tracemalloc.start()
    state = detector.init(frames.shape[1:])
    for frame in frames:
        state, declared = detector.step(state, frame, None)
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert not np.any(declared.any)
    assert planes * size * frame.size <= held <= 3 * planes * size * frame.size
