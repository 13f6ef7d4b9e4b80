"""How an object of a scenario moves: along legs, through waypoints, or at random."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import process_noise_sqrt
from lowsnr_common.core.motion import transition_matrix
from lowsnr_common.core.motion import VEL
from lowsnr_common.settings.config import check_settings
from lowsnr_common.settings.config import setting
import numpy as np
import scipy

MOST_FRAMES = 1_000_000
# Random paths are drawn many at a time, and the first that fits is taken.
_DRAWS = 200
_MOST_ROUNDS = 50
_MOST_RANDOM_FRAMES = 10_000


@dataclass(frozen=True, kw_only=True)
class Start:
    """Where a manoeuvre starts and where it heads."""

    x_m: float = setting(0.0, 'position along the columns [m]')
    y_m: float = setting(0.0, 'position along the rows, down [m]')
    heading_deg: float = setting(
        0.0, 'direction of motion, from x towards y [deg]', ge=-360.0, le=360.0)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, kw_only=True)
class Leg:
    """One leg of a manoeuvre, up to and including a frame."""

    until_frame: int = setting(
        1, 'last frame that the leg leads to', ge=1, le=MOST_FRAMES)
    speed_mps: float = setting(0.5, 'speed [m/s]', ge=0.0)
    turn_rate_deg_s: float = setting(
        0.0, 'turn rate, from x towards y [deg/s]', ge=-360.0, le=360.0)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, kw_only=True)
class Waypoint:
    """Where the object is in a frame."""

    frame: int = setting(1, 'frame', ge=1, le=MOST_FRAMES)
    x_m: float = setting(0.0, 'position along the columns [m]')
    y_m: float = setting(0.0, 'position along the rows, down [m]')

    def __post_init__(self) -> None:
        check_settings(self)


def path_along_legs(
    start: Start, legs: Sequence[Leg], first_frame: int, period_s: float,
    acceleration_density: float, rng: np.random.Generator,
) -> np.ndarray:
    """
    Move by eq. (1), each leg with its speed and turn rate.

    Parameters
    ----------
    start
        Position and heading in the first frame; the speed is the first leg's.
    legs
        Legs in order; the heading carries on from one to the next.
    first_frame
        Frame of the start.
    period_s
        Time from a frame to the next [s].
    acceleration_density
        Process noise v_k [m^2/s^3], 0 for none.
    rng
        Source of the process noise.

    Returns
    -------
    (frames, 4) ndarray
        States [m, m/s].

    """
    heading = np.deg2rad(start.heading_deg)
    state = np.array([start.x_m, np.cos(heading), start.y_m, np.sin(heading)])
    direction = state[VEL]
    state[VEL] = direction * legs[0].speed_mps
    path, frame = [state], first_frame
    factor = process_noise_sqrt(period_s, acceleration_density)
    for leg in legs:
        step = transition_matrix(period_s, np.deg2rad(leg.turn_rate_deg_s))
        state = state.copy()
        state[VEL] = direction * leg.speed_mps
        while frame < leg.until_frame:
            state = step @ state + factor @ rng.standard_normal(4)
            path.append(state)
            frame += 1
        speed = np.hypot(*state[VEL])
        direction = state[VEL] / speed if speed > 0.0 else direction
    return np.array(path)


def path_through_waypoints(waypoints: Sequence[Waypoint], period_s: float) -> np.ndarray:
    """Return the (frames, 4) states [m, m/s] of a cubic spline through the waypoints."""
    frames = np.array([point.frame for point in waypoints])
    spline = scipy.interpolate.CubicSpline(
        frames * period_s, [(point.x_m, point.y_m) for point in waypoints])
    times = np.arange(frames[0], frames[-1] + 1) * period_s
    path = np.empty((len(times), 4))
    path[:, POS] = spline(times)
    path[:, VEL] = spline(times, 1)
    return path


def path_at_random(
    motion: MotionModes, count: int, extent_m: tuple[float, float], cell_size_m: float,
    period_s: float, rng: np.random.Generator,
) -> np.ndarray:
    """
    Draw a path from motion modes that stays in the frame and within the speed limits.

    Parameters
    ----------
    motion
        Modes, their switching and the limits of speed.
    count
        Frames the object is present.
    extent_m
        Width and height of the frame [m].
    cell_size_m
        Side of a cell [m].
    period_s
        Time from a frame to the next [s].
    rng
        Source of randomness.

    Returns
    -------
    (count, 4) ndarray
        States [m, m/s].

    Raises
    ------
    ValueError
        If the path is too long, or none fits into the frame.

    """
    if count > _MOST_RANDOM_FRAMES:
        raise ValueError(
            f'a random path of {count} frames, must be of at most {_MOST_RANDOM_FRAMES}')
    low = np.full(2, -cell_size_m / 2)
    high = np.array(extent_m) - cell_size_m / 2
    for _ in range(_MOST_ROUNDS):
        states = np.empty((_DRAWS, 4))
        states[:, POS] = rng.uniform(low, high, (_DRAWS, 2))
        states[:, VEL] = motion.draw_velocity((_DRAWS,), rng)
        modes = rng.integers(motion.count, size=_DRAWS)
        steps, fits = [states], np.ones(_DRAWS, dtype=bool)
        while len(steps) < count and fits.any():
            modes = motion.switch(modes, period_s, rng)
            steps.append(motion.move(steps[-1], modes, period_s, rng))
            fits &= _fits(steps[-1], motion, low, high)
        fits &= _fits(steps[0], motion, low, high)
        if fits.any():
            return np.stack([states[fits.argmax()] for states in steps])
    raise ValueError(
        f'no random path of {count} frames fits into a frame of '
        f'{extent_m[0]:g} x {extent_m[1]:g} m at these speeds')


def _fits(
    states: np.ndarray, motion: MotionModes, low: np.ndarray, high: np.ndarray,
) -> np.ndarray:
    """Return which states (n, 4) are in the frame and within the speed limits, (n,) of bool."""
    place, speed = states[:, POS], np.linalg.norm(states[:, VEL], axis=-1)
    inside = np.all((place >= low) & (place < high), axis=-1)
    return inside & (speed >= motion.min_speed_mps) & (speed <= motion.max_speed_mps)
