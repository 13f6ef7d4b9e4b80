# SPDX-License-Identifier: Apache-2.0
"""Trajectories: legs and splines against closed forms, random ones against their limits."""

from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import process_noise_cov
from lowsnr_common.core.motion import transition_matrix
from lowsnr_common.core.motion import VEL
from lowsnr_sensor.trajectories import Leg
from lowsnr_sensor.trajectories import random_trajectory
from lowsnr_sensor.trajectories import Start
from lowsnr_sensor.trajectories import trajectory_along_legs
from lowsnr_sensor.trajectories import trajectory_through_waypoints
from lowsnr_sensor.trajectories import Waypoint
import numpy as np
import pytest


def test_straight_leg_is_a_line(rng):
    start = Start(x_m=1.0, y_m=2.0, heading_deg=30.0)
    path = trajectory_along_legs(start, [Leg(until_frame=9, speed_mps=0.8)], 4, 0.5, 0.0, rng)
    velocity = 0.8 * np.array([np.cos(np.pi / 6), 0.5])
    times = 0.5 * np.arange(6)
    np.testing.assert_allclose(path[:, POS], [1.0, 2.0] + times[:, None] * velocity)
    np.testing.assert_allclose(path[:, VEL], np.tile(velocity, (6, 1)))


def test_turning_leg_is_a_circle(rng):
    leg = Leg(until_frame=13, speed_mps=0.6, turn_rate_deg_s=30.0)
    path = trajectory_along_legs(Start(x_m=5.0, y_m=3.0), [leg], 1, 1.0, 0.0, rng)
    radius = 0.6 / np.deg2rad(30.0)
    angle = np.deg2rad(30.0) * np.arange(13)
    circle = np.column_stack([5.0 + radius * np.sin(angle), 3.0 + radius * (1 - np.cos(angle))])
    np.testing.assert_allclose(path[:, POS], circle, atol=1e-12)
    np.testing.assert_allclose(path[-1], path[0], atol=1e-12)


def test_legs_keep_the_heading_and_set_the_speed(rng):
    legs = [Leg(until_frame=4, speed_mps=1.0, turn_rate_deg_s=30.0),
            Leg(until_frame=6, speed_mps=0.0), Leg(until_frame=8, speed_mps=2.0)]
    path = trajectory_along_legs(Start(), legs, 1, 1.0, 0.0, rng)
    assert len(path) == 8
    np.testing.assert_allclose(np.hypot(*path[:, VEL].T), [1, 1, 1, 1, 0, 0, 2, 2], atol=1e-12)
    np.testing.assert_allclose(path[3, VEL], [0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(path[7, POS] - path[5, POS], [0.0, 4.0], atol=1e-12)


def test_legs_have_the_process_noise_of_eq_1(rng):
    density, trials = 0.2, 4_000
    leg = Leg(until_frame=4, speed_mps=1.0)
    ends = np.array([
        trajectory_along_legs(Start(), [leg], 1, 1.0, density, rng)[-1] for _ in range(trials)])
    step, cov = transition_matrix(1.0), np.zeros((4, 4))
    for _ in range(3):
        cov = step @ cov @ step.T + process_noise_cov(1.0, density)
    assert np.all(abs(ends.mean(axis=0) - [3, 1, 0, 0]) < 4 * np.sqrt(np.diag(cov) / trials))
    sigma = np.sqrt((np.outer(np.diag(cov), np.diag(cov)) + cov**2) / trials)
    assert np.all(abs(np.cov(ends.T) - cov) < 4 * sigma)


def test_two_waypoints_are_a_line():
    path = trajectory_through_waypoints(
        [Waypoint(frame=3, x_m=1.0, y_m=5.0), Waypoint(frame=7, x_m=3.0, y_m=1.0)], 2.0)
    np.testing.assert_allclose(path[:, POS], np.linspace([1.0, 5.0], [3.0, 1.0], 5))
    np.testing.assert_allclose(path[:, VEL], np.tile([0.25, -0.5], (5, 1)))


def test_trajectory_meets_the_waypoints_and_velocity_is_its_derivative():
    points = [Waypoint(frame=k, x_m=x, y_m=y)
              for k, x, y in [(2, 1.0, 4.0), (6, 3.0, 2.0), (11, 6.0, 5.0), (14, 5.0, 8.0)]]
    path = trajectory_through_waypoints(points, 0.5)
    for point in points:
        np.testing.assert_allclose(path[point.frame - 2, POS], [point.x_m, point.y_m])
    # The mid-point rule is off by T^2/6 of the third derivative, which a cubic has constant.
    middle = (path[2:, POS] - path[:-2, POS]) / 1.0
    inner = [k for k in range(1, len(path) - 1) if k + 2 not in (6, 11)]
    bend = np.diff(path[:, POS], 3, axis=0)
    np.testing.assert_allclose(
        path[inner][:, VEL], middle[np.array(inner) - 1], atol=abs(bend).max() / 3)


def test_random_trajectories_keep_to_the_frame_and_the_speeds(rng, grid_shape):
    rows, cols = grid_shape
    motion = MotionModes(min_speed_mps=0.2, max_speed_mps=0.6)
    for _ in range(30):
        path = random_trajectory(motion, 10, (cols * 0.5, rows * 0.5), 0.5, 1.0, rng)
        assert path.shape == (10, 4)
        pixel = path[:, POS] / 0.5
        assert np.all((pixel >= -0.5) & (pixel < [cols - 0.5, rows - 0.5]))
        speed = np.hypot(*path[:, VEL].T)
        assert np.all((speed >= 0.2) & (speed <= 0.6))


def test_random_trajectory_that_cannot_fit_is_rejected(rng):
    motion = MotionModes(min_speed_mps=50.0, max_speed_mps=60.0)
    with pytest.raises(ValueError, match='5 x 7'):
        random_trajectory(motion, 2, (5.0, 7.0), 1.0, 1.0, rng)
