"""The velocity bank against its definition, and what it finds and ignores."""

from lowsnr_common.core.measurement import SensorModel
from lowsnr_detect.detectors.velocity_bank import places
from lowsnr_detect.detectors.velocity_bank import shift_and_add
from lowsnr_detect.detectors.velocity_bank import velocity_grid
from lowsnr_detect.detectors.velocity_bank import VelocityBank
import numpy as np
import pytest

SHAPE = (40, 56)


def test_grid_is_the_disc_of_points_with_zero_first():
    velocity = velocity_grid(1.5, 4)
    wanted = {(0.375 * i, 0.375 * j) for i in range(-4, 5)
              for j in range(-4, 5) if i * i + j * j <= 16}
    assert {tuple(each) for each in velocity.tolist()} == wanted
    assert len(velocity) == len(wanted) == 49
    assert not velocity[0].any()


@pytest.mark.parametrize('shape', [(1, 1), (1, 9), (23, 17), (2, 3, 19, 5)])
@pytest.mark.parametrize('settings', [{}, {'regions': 3}, {'fastest': 6.0, 'rings': 2}])
def test_compiled_loops_are_the_definition(rng, shape, settings):
    bank = VelocityBank(sensor=SensorModel(noise_std=1.3), limit=2.5, **settings)
    state, sums = bank.init(shape), np.zeros((len(bank.velocity), *shape))
    for k in range(1, 8):
        frame = 1.3 * rng.standard_normal(shape)
        state, plane = bank.statistic(state, frame)
        moves = places(bank.velocity, k) - places(bank.velocity, k - 1)
        sums, u = shift_and_add(
            sums, np.clip(frame / 1.3, -2.5, 2.5), moves, bank.std(k), 0.85, 0.5)
        assert state.sums == pytest.approx(sums, abs=1e-5)
        assert plane == pytest.approx(np.maximum(u, 0.0)**2 / 2.0, rel=1e-4, abs=1e-5)


def test_std_is_that_of_white_noise_for_every_velocity_and_frame(rng):
    bank = VelocityBank()
    # Cells that no path enters from outside: speed 1.5 for 20 frames is 30 cells.
    shape, inside = (6, 90, 90), (..., slice(32, 58), slice(32, 58))
    state = bank.init(shape)
    for k in range(1, 21):
        state, _ = bank.statistic(state, rng.standard_normal(shape))
        if k in (1, 2, 7, 20):
            difference = (state.sums - 0.5 * state.sums[0])[inside]
            measured = difference[1:].std(axis=(1, 2, 3))
            # 4,056 cells of a velocity: four standard errors of a standard deviation are 4.4 %,
            # and neighbours are independent.
            assert measured == pytest.approx(bank.std(k)[1:], rel=0.055)


@pytest.mark.parametrize('speed', [0.3, 0.8, 1.5])
def test_moving_object_is_found_where_it_is(rng, speed):
    # Three sigma in each of four cells, as an object is after a camera's blur; 12 frames.
    bank, hits = VelocityBank(threshold=16.0), 0
    for heading in np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False):
        step = speed * np.array([np.sin(heading), np.cos(heading)])
        state, place = bank.init(SHAPE), np.array([20.0, 28.0])
        for _ in range(12):
            frame = rng.standard_normal(SHAPE)
            row, col = np.floor(place).astype(int)
            frame[row:row + 2, col:col + 2] += 3.0
            state, declared = bank.step(state, frame, rng)
            last, place = place, place + step
        found = declared.state[declared.score > 0.0][:, [2, 0]]
        hits += bool(len(found)) and bool(np.linalg.norm(found - last, axis=1).min() <= 2.0)
    assert hits >= 7


def test_what_stands_takes_itself_out(rng):
    level = {}
    for standing in (0.0, 0.5):
        bank, most = VelocityBank(standing=standing), []
        state = bank.init(SHAPE)
        for k in range(60):
            frame = np.random.default_rng(k).standard_normal(SHAPE)
            frame[20, 28] += 3.0
            state, plane = bank.statistic(state, frame)
            most.append(plane[20, 28])
        level[standing] = np.mean(most[20:])
    assert level[0.5] < 0.5 * level[0.0]


def test_blank_frames_before_the_first_one_are_not_counted(rng):
    bank = VelocityBank()
    frames = rng.standard_normal((3, *SHAPE))
    one, other = bank.init(SHAPE), bank.init(SHAPE)
    for _ in range(5):
        other, _ = bank.statistic(other, np.zeros(SHAPE))
    for frame in frames:
        one, first = bank.statistic(one, frame)
        other, second = bank.statistic(other, frame)
        assert np.array_equal(first, second)
