# SPDX-License-Identifier: Apache-2.0
"""Trajectories of objects: along legs, through waypoints, or at random."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import replace

from lowsnr_common.core.bound_motion import DestinationDensity
from lowsnr_common.core.bound_motion import draw_bound
from lowsnr_common.core.bound_motion import move_bound
from lowsnr_common.core.bound_motion import PlaceDensity
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import process_noise_sqrt
from lowsnr_common.core.motion import transition_matrix
from lowsnr_common.core.motion import VEL
from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import setting
import numpy as np
import scipy

MAX_FRAMES = 1_000_000
# A random trajectory is the first that fits of up to 50 batches of 200, 10,000 draws in all.
_BATCH = 200
_MAX_BATCHES = 50
# A batch of so many frames takes 64 MB.
_MAX_RANDOM_FRAMES = 10_000


@dataclass(frozen=True, kw_only=True)
class Start:
    """Position and heading at the start of a manoeuvre."""

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
        1, 'last frame of the leg', ge=1, le=MAX_FRAMES)
    speed_mps: float = setting(0.5, 'speed [m/s]', ge=0.0)
    turn_rate_deg_s: float = setting(
        0.0, 'turn rate, from x towards y [deg/s]', ge=-360.0, le=360.0)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, kw_only=True)
class Waypoint:
    """Position of the object in a frame."""

    frame: int = setting(1, 'frame', ge=1, le=MAX_FRAMES)
    x_m: float = setting(0.0, 'position along the columns [m]')
    y_m: float = setting(0.0, 'position along the rows, down [m]')

    def __post_init__(self) -> None:
        check_settings(self)


def trajectory_along_legs(
    start: Start, legs: Sequence[Leg], first_frame: int, period_s: float,
    acceleration_density: float, rng: np.random.Generator,
) -> np.ndarray:
    """
    Move an object by eq. (1), on each leg with its speed and turn rate.

    Parameters
    ----------
    start
        Position and heading in the first frame; the speed is the first leg's.
    legs
        Legs in order; each starts with the heading at the end of the one before.
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
    states, frame = [state], first_frame
    factor = process_noise_sqrt(period_s, acceleration_density)
    for leg in legs:
        step = transition_matrix(period_s, np.deg2rad(leg.turn_rate_deg_s))
        state = state.copy()
        state[VEL] = direction * leg.speed_mps
        while frame < leg.until_frame:
            state = step @ state + factor @ rng.standard_normal(4)
            states.append(state)
            frame += 1
        speed = np.hypot(*state[VEL])
        direction = state[VEL] / speed if speed > 0.0 else direction
    return np.array(states)


def trajectory_through_waypoints(waypoints: Sequence[Waypoint], period_s: float) -> np.ndarray:
    """Return the (frames, 4) states [m, m/s] of a cubic spline through the waypoints."""
    frames = np.array([point.frame for point in waypoints])
    spline = scipy.interpolate.CubicSpline(
        frames * period_s, [(point.x_m, point.y_m) for point in waypoints])
    times = np.arange(frames[0], frames[-1] + 1) * period_s
    states = np.empty((len(times), 4))
    states[:, POS] = spline(times)
    states[:, VEL] = spline(times, 1)
    return states


def random_trajectory(
    motion: MotionModes, count: int, extent_m: tuple[float, float], cell_size_m: float,
    period_s: float, rng: np.random.Generator, origin: PlaceDensity | None = None,
    destinations: Sequence[DestinationDensity] = (), first_frame: int = 1,
) -> np.ndarray:
    """
    Draw a trajectory from motion modes, inside the frame and within the speed limits.

    Parameters
    ----------
    motion
        Modes, their switching and the limits of speed.
    count
        Number of frames in which the object is present.
    extent_m
        Width and height of the frame [m].
    cell_size_m
        Side of a cell [m].
    period_s
        Time from a frame to the next [s].
    rng
        Source of randomness.
    origin
        Where it appears; None for uniform in the frame.
    destinations
        Where it may be bound for.
    first_frame
        Frame in which it appears, as that of an arrival is counted.

    Returns
    -------
    (count, 4) ndarray
        States [m, m/s].

    Raises
    ------
    ValueError
        If the trajectory is too long, or no draw fits.

    """
    if count > _MAX_RANDOM_FRAMES:
        raise ValueError(
            f'a random trajectory of {count} frames must have at most {_MAX_RANDOM_FRAMES}')
    low = np.full(2, -cell_size_m / 2)
    high = np.array(extent_m) - cell_size_m / 2
    chosen = _chosen(destinations, rng)
    for _ in range(_MAX_BATCHES):
        states = np.empty((_BATCH, 4))
        states[:, POS] = (
            origin.draw((_BATCH,), rng) if origin else rng.uniform(low, high, (_BATCH, 2)))
        states[:, VEL] = motion.draw_velocity((_BATCH,), rng)
        modes = rng.integers(motion.count, size=_BATCH)
        steps, fits = [states], np.ones(_BATCH, dtype=bool)
        bound = draw_bound(chosen, (_BATCH,), rng) if chosen else None
        while len(steps) < count and fits.any():
            modes = motion.switch(modes, period_s, rng)
            steps.append(
                motion.move(steps[-1], modes, period_s, rng) if bound is None else move_bound(
                    motion, steps[-1], modes, bound.place,
                    bound.left_s(first_frame + len(steps), period_s), period_s, rng))
            fits &= _fits(steps[-1], motion, low, high)
        fits &= _fits(steps[0], motion, low, high)
        if fits.any():
            return np.stack([states[fits.argmax()] for states in steps])
    raise ValueError(
        f'no random trajectory of {count} frames fits into a frame of '
        f'{extent_m[0]:g} x {extent_m[1]:g} m at these speeds')


def _chosen(
    destinations: Sequence[DestinationDensity], rng: np.random.Generator,
) -> list[DestinationDensity]:
    """
    Draw the one that an object is bound for, and the frame of its arrival; empty for none.

    They are drawn once: what does not fit is drawn again, and would be chosen less often.
    """
    if not destinations:
        return []
    ends = np.cumsum([each.probability for each in destinations])
    number = int(np.searchsorted(ends, rng.random(), side='right'))
    if number == len(destinations):
        return []
    found = destinations[number]
    arrival = int(rng.integers(found.earliest_frame, found.latest_frame + 1))
    return [replace(found, probability=1.0, earliest_frame=arrival, latest_frame=arrival)]


def _fits(
    states: np.ndarray, motion: MotionModes, low: np.ndarray, high: np.ndarray,
) -> np.ndarray:
    """Return whether each state (n, 4) is inside the frame and the speed limits, (n,)."""
    position, speed = states[:, POS], np.linalg.norm(states[:, VEL], axis=-1)
    inside = np.all((position >= low) & (position < high), axis=-1)
    fits: np.ndarray = inside & (speed >= motion.min_speed_mps) & (
        speed <= motion.max_speed_mps)
    return fits
