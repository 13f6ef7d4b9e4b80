# SPDX-License-Identifier: Apache-2.0
"""Moves on the grid follow from the motion modes."""

from lowsnr_common.core.destination import Destination
from lowsnr_common.core.destination import state_likelihood
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_detect.parts.destination_moves import cell_likelihoods
from lowsnr_detect.parts.destination_moves import move_likelihoods
from lowsnr_detect.parts.moves import best_vicinity
from lowsnr_detect.parts.moves import move_model
from lowsnr_detect.parts.moves import shifted
from lowsnr_detect.parts.moves import vicinity_max
import numpy as np
import pytest

# 400 000 sampled moves: four standard errors of a probability.
ERROR = 4 * 0.5 / np.sqrt(400_000)
SHAPE = (12, 9)
TO = Destination(probability=0.9, x_m=6.0, y_m=8.0, std_m=0.8, arrival_frame=10)


def straight(speed):
    """Return motion straight ahead at one speed."""
    return MotionModes(turn_rates_deg_s=(0.0,), acceleration_density=0.0,
                       min_speed_mps=speed, max_speed_mps=speed)


@pytest.mark.parametrize('speed', [0.3, 0.9])
def test_probability_to_stay_is_the_overlap_of_the_moved_cell(speed):
    model = move_model(straight(speed), SensorModel(), 0)
    prob = dict(zip(map(tuple, model.moves), model.kernel.ravel()))
    # Mean over the heading of (1 - |v_x|) (1 - |v_y|).
    assert prob[0, 0] == pytest.approx(1 - 4 * speed / np.pi + speed**2 / np.pi, abs=ERROR)
    assert prob[0, 1] == pytest.approx(prob[0, -1], abs=2 * ERROR)
    assert prob[1, 0] == pytest.approx(prob[0, 1], abs=2 * ERROR)


def test_moves_scale_with_cell_and_frame_period():
    whole = move_model(straight(0.6), SensorModel(), 1)
    scaled = move_model(straight(0.9), SensorModel(cell_size_m=3.0, frame_period_s=2.0), 1)
    assert scaled.kernel == pytest.approx(whole.kernel, abs=0.05)
    assert move_model(straight(1.8), SensorModel(), 0).moves.max() == 2


@pytest.mark.parametrize('order', [0, 1, 2])
def test_probabilities_sum_to_one_and_none_is_impossible(order):
    model = move_model(MotionModes(), SensorModel(), order)
    assert model.kernel.sum(axis=1) == pytest.approx(1.0)
    assert model.kernel.min() > 0.0
    assert model.history.sum() == pytest.approx(1.0)


def test_two_moves_to_the_right_are_followed_by_another():
    model = move_model(straight(0.9), SensorModel(), 2)
    right = [tuple(move) for move in model.moves].index((0, 1))
    onwards = model.moves[:, 1] == 1
    assert model.kernel[right, onwards, right].sum() > 0.75
    assert model.kernel[right, :, right].argmax() == right
    assert model.velocity[right, right] == pytest.approx([0.85, 0.0], abs=0.06)


def test_velocity_given_no_history_is_that_of_all_objects():
    model = move_model(MotionModes(acceleration_density=0.0), SensorModel(), 0)
    assert model.velocity == pytest.approx(0.0, abs=0.005)
    # Speed uniform on [0, 1]: the mean square of a component is 1/6.
    assert model.velocity_cov[0, 0] == pytest.approx(np.eye(2) / 6.0, abs=0.003)


@pytest.mark.parametrize('move', [(0, 0), (1, 0), (-1, 2), (0, -3), (9, 0), (-4, -3)])
def test_shift_moves_what_stays_inside(rng, move):
    plane = rng.standard_normal((2, 4, 3))
    moved = shifted(plane, np.array(move), -7.0)
    for row, col in np.ndindex(4, 3):
        source = row - move[0], col - move[1]
        inside = 0 <= source[0] < 4 and 0 <= source[1] < 3
        expected = plane[:, source[0], source[1]] if inside else -7.0
        assert np.all(moved[:, row, col] == expected)


def test_best_vicinity_of_equal_moves_is_the_plain_maximum(rng):
    plane = rng.standard_normal((3, 6, 4))
    moves = np.stack(np.divmod(np.arange(25), 5), axis=-1) - 2
    assert np.array_equal(best_vicinity(plane, moves, np.zeros(25)), vicinity_max(plane, 2))


def test_best_vicinity_takes_the_log_probability_of_the_cell_that_is_left(rng):
    plane, log_prob = rng.standard_normal((2, 6, 4)), rng.standard_normal((9, 6, 4))
    moves = np.stack(np.divmod(np.arange(9), 3), axis=-1) - 1
    expected = np.max([
        shifted(plane + own, move, -np.inf) for move, own in zip(moves, log_prob)], axis=0)
    assert np.array_equal(best_vicinity(plane, moves, log_prob), expected)


def simulated(cell, frame, sensor, motion, rng):
    """Return states in a cell before, and after the move into a frame, of the base motion."""
    states = np.empty((200_000, 4))
    size = sensor.cell_size_m
    states[:, [0, 2]] = size * (cell[::-1] + rng.uniform(-0.5, 0.5, (len(states), 2)))
    states[:, [1, 3]] = motion.draw_velocity((len(states),), rng)
    modes = motion.switch(
        rng.integers(motion.count, size=len(states)), sensor.frame_period_s, rng)
    return states, motion.move(states, modes, sensor.frame_period_s, rng)


@pytest.mark.parametrize(('cell', 'frame'), [
    ((3, 2), 2), ((6, 4), 2), ((6, 4), 6), ((5, 7), 2), ((5, 7), 6), ((9, 6), 2), ((9, 6), 6),
    ((9, 6), 10)])
def test_moves_to_a_destination_are_those_of_the_bridge(rng, cell, frame):
    # The grid describes velocities by mean and variance only, so that up to 0.06 of the
    # probability is with other moves in the cells that objects pass; without the destination it
    # is 0.18 to 0.35.
    sensor, motion = SensorModel(cell_size_m=2.0, frame_period_s=2.0), MotionModes()
    to = Destination(probability=0.9, x_m=12.0, y_m=16.0, std_m=1.6, arrival_frame=10)
    _, moved = simulated(np.array(cell), frame, sensor, motion, rng)
    weight = state_likelihood(to, moved, frame, 2.0, 4.0 * 12 * 9)
    steps = sensor.cells(moved) - cell
    model = move_model(motion, sensor, 0)
    expected = np.array([
        weight @ np.all(steps == move, axis=1) for move in model.moves]) / weight.sum()
    likelihood, mean = move_likelihoods(to, motion, sensor, 0, frame, SHAPE)
    found = (model.kernel[0, :, 0, None, None] * likelihood[0] / mean[0, 0])[:, *cell]
    assert abs(found - expected).sum() / 2.0 < 0.07
    assert abs(model.kernel[0, :, 0] - expected).sum() / 2.0 > 0.15


@pytest.mark.parametrize('frame', [1, 6, 10])
def test_likelihood_of_a_cell_is_the_mean_of_the_objects_in_it(rng, frame):
    sensor, motion = SensorModel(), MotionModes(acceleration_density=0.01)
    found = cell_likelihoods(TO, motion, sensor, 0, frame, SHAPE)[0, 0]
    for cell in ((7, 5), (8, 6), (3, 2), (0, 8)):
        states, _ = simulated(np.array(cell), frame, sensor, motion, rng)
        expected = state_likelihood(TO, states, frame, 1.0, 108.0).mean()
        assert found[cell] == pytest.approx(expected, rel=0.35)


@pytest.mark.parametrize('order', [0, 1, 2])
def test_moves_to_a_destination_sum_to_one(order):
    model = move_model(MotionModes(), SensorModel(), order)
    likelihood, mean = move_likelihoods(TO, MotionModes(), SensorModel(), order, 4, SHAPE)
    prob = (model.kernel[..., None, None] * likelihood[:, :, None]
            / mean.swapaxes(0, 1)[:, None])
    assert prob.sum(axis=1) == pytest.approx(1.0)
    vague = Destination(probability=0.9, std_m=1e6)
    likelihood, mean = move_likelihoods(vague, MotionModes(), SensorModel(), order, 4, SHAPE)
    assert likelihood == pytest.approx(0.1)
    assert mean == pytest.approx(0.1)


@pytest.mark.parametrize('radius', [0, 1, 2, 9])
def test_vicinity_maximum_is_that_of_every_window(rng, radius):
    plane = rng.standard_normal((2, 6, 4))
    found = vicinity_max(plane, radius)
    for row, col in np.ndindex(6, 4):
        window = plane[:, max(row - radius, 0):row + radius + 1,
                       max(col - radius, 0):col + radius + 1]
        assert np.array_equal(found[:, row, col], window.max(axis=(1, 2)))
