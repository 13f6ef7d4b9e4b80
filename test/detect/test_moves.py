"""Moves on the grid follow from the motion modes."""

from lowsnr_detect.moves import best_vicinity
from lowsnr_detect.moves import move_model
from lowsnr_detect.moves import shifted
from lowsnr_detect.sequential import vicinity_max
from lowsnr_sensor.measurement import SensorModel
from lowsnr_sensor.motion import MotionModes
import numpy as np
import pytest

# 400 000 sampled moves: four standard errors of a probability.
ERROR = 4 * 0.5 / np.sqrt(400_000)


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


def test_best_vicinity_without_a_bonus_is_the_plain_maximum(rng):
    plane = rng.standard_normal((3, 6, 4))
    moves = np.stack(np.divmod(np.arange(25), 5), axis=-1) - 2
    assert np.array_equal(best_vicinity(plane, moves, np.zeros(25)), vicinity_max(plane, 2))
