# SPDX-License-Identifier: Apache-2.0
"""The velocity bank against its definition, and what it finds and ignores."""

from lowsnr_common.core.measurement import SensorModel
from lowsnr_detect.detectors.velocity_bank import places
from lowsnr_detect.detectors.velocity_bank import shift_and_add
from lowsnr_detect.detectors.velocity_bank import velocity_grid
from lowsnr_detect.detectors.velocity_bank import VelocityBank
from lowsnr_detect.parts.moved_memory import moved_memory
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


def defined(bank, frames):
    """Yield what the bank keeps and returns after each frame, and S_k and u_k as defined."""
    state, sums = bank.init(frames.shape[1:]), np.zeros((len(bank.velocity), *frames.shape[1:]))
    for k, frame in enumerate(frames, 1):
        state, plane = bank.statistic(state, frame)
        moves = places(bank.velocity, k) - places(bank.velocity, k - 1)
        z = np.clip(frame / bank.sensor.noise_std, -bank.limit, bank.limit)
        sums, u = shift_and_add(sums, z, moves, bank.std(k), bank.fading, bank.standing)
        yield state, plane, sums, u


@pytest.mark.parametrize('shape', [(1, 1), (1, 9), (23, 17), (2, 3, 19, 5)])
@pytest.mark.parametrize('settings', [
    {}, {'regions': 3}, {'fastest': 6.0, 'rings': 2}, {'fading': 0.0}, {'limit': 2.5}])
def test_compiled_loops_are_the_definition_within_half_a_step_a_frame(rng, shape, settings):
    bank = VelocityBank(sensor=SensorModel(noise_std=1.3), **settings)
    rounding = 0.5 * bank.step_std / (1.0 - bank.fading) + 1e-5
    least = 1.0 - bank.standing  # std D_1
    for state, plane, sums, u in defined(bank, 1.3 * rng.standard_normal((7, *shape))):
        assert state.sums == pytest.approx(sums, abs=rounding)
        assert np.sqrt(2.0 * plane) == pytest.approx(
            np.maximum(u, 0.0), abs=(1.0 + bank.standing) * rounding / least)


def test_sums_in_whole_steps_change_the_statistic_by_less_than_a_hundredth(rng):
    frames = rng.standard_normal((60, 30, 40)) + 40.0 * (rng.random((30, 40)) < 0.05)
    for _, plane, _, u in defined(VelocityBank(), frames):
        assert np.sqrt(2.0 * plane) == pytest.approx(np.maximum(u, 0.0), abs=0.01)


@pytest.mark.parametrize('sign', [-1.0, 1.0])
def test_sums_beyond_what_is_stored_are_cut(sign):
    bank = VelocityBank(limit=1e6, fading=0.99)
    state = bank.init((3, 4))
    for _ in range(3):
        state, _ = bank.statistic(state, np.full((3, 4), sign * 200.0))
    assert state.sums[0] == pytest.approx(np.full((3, 4), sign * 256.0))


def test_sums_move_with_the_camera(rng):
    bank, frame = VelocityBank(), rng.standard_normal((2, 9, 12))
    state, _ = bank.statistic(bank.init(frame.shape), frame)
    moved = moved_memory(state, bank.init(frame.shape), (9, 12), (2, -3), 1.0)
    wanted = np.zeros_like(state.sums)
    wanted[..., :-2, 3:] = state.sums[..., 2:, :-3]
    assert np.array_equal(moved.sums, wanted)
    bank.statistic(moved, frame)


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
