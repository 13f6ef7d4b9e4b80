"""The compiled loops over cells compute what plain NumPy does."""

from dataclasses import replace
import tracemalloc

from detect import numpy_detectors
from lowsnr_common.core import compiled
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_detect.detectors.cusum import CUSUM
from lowsnr_detect.detectors.hmm import HMM
from lowsnr_detect.detectors.sdt import SDT
from lowsnr_detect.node.warm_up import rehearse
from lowsnr_detect.parts.grid_filter import move_and_weigh
from lowsnr_detect.parts.moves import best_vicinity
from lowsnr_detect.parts.moves import move_model
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


@pytest.mark.parametrize('shape', SHAPES)
@pytest.mark.parametrize('settings', [
    {}, {'radius': 0}, {'radius': 2}, {'radius': 3}, {'restart': 'unused'},
    {'restart': 'unused', 'radius': 2}, {'upper_threshold': 3.0}, {'max_iterations': 1},
    {'max_iterations': 2, 'upper_threshold': 1.5, 'restart': 'unused'}])
def test_sdt_extends_paths_as_in_numpy_to_the_bit(rng, shape, settings):
    detector = SDT(sensor=SENSOR, alpha=0.1, beta=0.1, threshold=1.0, **settings)
    lower, upper = wald_bounds(0.1, 0.1)[0], detector.upper_threshold
    state = detector.init(shape)
    for _ in range(7):
        frame = 1.3 * rng.standard_normal(shape) + 0.5
        expected = numpy_detectors.extend_paths(
            state.log_ratio, ratio_of(frame), detector.radius, detector.restart == 'unused',
            floor32(lower), floor32(upper))
        state, declared = detector.step(state, frame, None)
        assert np.array_equal(state.log_ratio, expected[:-1])
        assert np.array_equal(declared.peak, expected[-1].max(axis=(-2, -1)))


@pytest.mark.parametrize('shape', SHAPES)
@pytest.mark.parametrize('speed', [1.0, 1.8])
def test_best_move_is_that_of_numpy_to_the_bit(rng, shape, speed):
    model = move_model(MotionModes(max_speed_mps=speed), SENSOR, 0)
    bonus = np.log(model.kernel.ravel()).astype(np.float32)
    for plane in (rng.standard_normal(shape), rng.standard_normal(shape).astype(np.float32)):
        for given in (bonus, bonus[:, None, None] + rng.random(shape[-2:]).astype(np.float32)):
            assert np.array_equal(
                best_vicinity(plane, model.moves, given),
                numpy_detectors.best_vicinity(plane, model.moves, given.astype(plane.dtype)))


@pytest.mark.parametrize('shape', SHAPES)
def test_cusum_extends_sums_as_in_numpy_to_the_bit(rng, shape):
    detector = CUSUM(sensor=SENSOR, drift=0.25, threshold=3.0, headroom=1.0)
    model, state = move_model(detector.motion, SENSOR, 0), detector.init(shape)
    bonus = np.log(model.kernel.ravel()).astype(np.float32)
    for _ in range(5):
        frame = 1.3 * rng.standard_normal(shape) + 0.5
        before = numpy_detectors.best_vicinity(state, model.moves, bonus)
        expected = numpy_detectors.extend_sums(
            before, ratio_of(frame), np.float32(0.25), np.float32(4.0))
        state, _ = detector.step(state, frame, None)
        assert np.array_equal(state, expected)


@pytest.mark.parametrize('shape', SHAPES)
@pytest.mark.parametrize(('order', 'speed'), [(0, 1.0), (1, 1.0), (2, 1.0), (0, 1.8), (1, 1.8)])
def test_belief_moves_as_in_numpy(rng, shape, order, speed):
    model = move_model(MotionModes(max_speed_mps=speed), SENSOR, order)
    belief = rng.random((*model.history.shape, *shape))
    weight, stays, born = rng.random(shape), rng.random(shape[:-2]), rng.random(shape[:-2])
    moved = numpy_detectors.move_belief(model, belief)
    share = model.history / np.prod(shape[-2:])
    expected = weight * (
        moved * stays[..., None, None]
        + share.reshape(*share.shape, *[1] * len(shape)) * born[..., None, None])
    found, inside, mass = move_and_weigh(model, belief, weight, stays, born)
    np.testing.assert_allclose(found, expected, rtol=1e-13)
    np.testing.assert_allclose(inside, moved.sum(axis=(0, 1, -2, -1)), rtol=1e-13)
    np.testing.assert_allclose(mass, expected.sum(axis=(0, 1, -2, -1)), rtol=1e-13)


@pytest.mark.parametrize('detector', [
    SDT(), SDT(restart='unused', radius=2), SDT(move_prior=True), CUSUM(), HMM(order=0),
    HMM(order=1)])
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
def test_bound_in_float32_parts_numbers_as_the_bound_does(bound):
    near, most = floor32(bound), np.float32(np.inf)
    for value in (np.nextafter(near, -most), near, np.nextafter(near, most), np.float32(bound)):
        assert (value > near) == (float(value) > bound)


@pytest.mark.parametrize('bound', [1e300, np.inf])
def test_bound_out_of_reach_of_float32_stays_so(bound):
    assert not np.float32(3e38) > floor32(bound)
    assert np.float32(-3e38) > floor32(-bound)


@pytest.mark.parametrize('name', sorted(DETECTORS))
@pytest.mark.parametrize('kind', [np.float32, np.float64])
def test_nothing_is_compiled_after_the_rehearsal(rng, name, kind, monkeypatch):
    few = {'particles': 100, 'birth_particles': 50}
    cls = detector_class(name)
    detector = cls(threshold=1.0, **{k: v for k, v in few.items() if hasattr(cls, k)})
    rehearse(detector)
    before = compiled.variants()
    state = detector.init((23, 17))
    for _ in range(5):
        frame = (rng.standard_normal((23, 17)) + 0.4).astype(kind)
        state, _ = detector.step(state, frame, rng)
    assert compiled.variants() == before


@pytest.mark.parametrize(('detector', 'planes', 'size'), [
    (SDT(threshold=50.0), 4, 4), (CUSUM(threshold=50.0), 1, 4), (HMM(order=0), 1, 8),
    (HMM(order=1), 9, 8)])
def test_detector_holds_at_most_three_times_its_planes(rng, detector, planes, size):
    frames = rng.standard_normal((3, 200, 200))
    rehearse(detector)
    tracemalloc.start()
    state = detector.init(frames.shape[1:])
    for frame in frames:
        state, declared = detector.step(state, frame, None)
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert not np.any(declared.any)
    assert planes * size * frame.size <= held <= 3 * planes * size * frame.size
