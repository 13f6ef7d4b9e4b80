# SPDX-License-Identifier: Apache-2.0
"""
Motion on the grid: which cell an object moves to from a frame to the next.

A move is a displacement in whole cells.  Its probability, given up to two moves before it,
follows from the motion modes: objects are drawn uniformly in a cell with the speeds, headings
and modes they appear with, moved, and their moves are counted.
"""

from __future__ import annotations

from dataclasses import dataclass
import functools
import math

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_common.images.bands import in_bands
from lowsnr_detect.parts.path_kernels import best_moves
import numpy as np

# Simulated objects: the standard error of a probability is at most 0.5 / sqrt(400 000) = 0.0008.
_SAMPLES = 400_000
_SEED = 0


@dataclass(frozen=True, eq=False)
class MoveModel:
    """
    Probabilities of moves, given the last ones.

    With n moves, the history of a cell is the pair (dropped, kept): of two remembered moves
    the older is dropped when the next is made; a single one is dropped; an axis that is not
    needed has length one.

    Parameters
    ----------
    moves : (n, 2) ndarray of int
        Rows and columns of each move.
    kernel : (kept, n, dropped) ndarray
        Probability of the next move given a history; sums to one over the moves.
    history : (dropped, kept) ndarray
        Probability of a history of an object that appears.
    velocity : (dropped, kept, 2) ndarray
        Mean v_x, v_y given the history [m/s].
    velocity_cov : (dropped, kept, 2, 2) ndarray
        Its covariance.

    """

    moves: np.ndarray
    kernel: np.ndarray
    history: np.ndarray
    velocity: np.ndarray
    velocity_cov: np.ndarray


@functools.lru_cache(maxsize=32)
def move_model(motion: MotionModes, sensor: SensorModel, order: int) -> MoveModel:
    """
    Count the moves of simulated objects.

    Parameters
    ----------
    motion
        How objects move.
    sensor
        Cell size and frame period.
    order
        Moves that the next one depends on: 0, 1 or 2.

    Returns
    -------
    MoveModel
        Its moves go at most as many cells as the highest speed covers, rounded up.

    """
    radius = move_radius(motion, sensor)
    steps, velocity = _simulated_moves(motion, sensor, order + 1)
    near = np.all(abs(steps) <= radius, axis=(1, 2))
    side = 2 * radius + 1
    number = (steps[near] + radius) @ np.array([side, 1])
    count = side**2
    moves = np.stack(np.divmod(np.arange(count), side), axis=-1) - radius
    size = count**order
    past = number[:, :order] @ count ** np.arange(order)[::-1]
    pairs = np.bincount(past * count + number[:, order], minlength=size * count)
    overall = np.bincount(number[:, order], minlength=count) + 1.0 / count
    # One more object for every history, whose moves are those of all objects: no move is
    # impossible.
    pairs = pairs.reshape(size, count) + overall / overall.sum()
    dropped, kept = (count, count) if order == 2 else (size, 1)
    kernel = (pairs / pairs.sum(axis=1, keepdims=True)).reshape(dropped, kept, count)
    history = pairs.sum(axis=1).reshape(dropped, kept)
    mean, cov = _moments(velocity[near], past, size)
    return MoveModel(
        moves, kernel.transpose(1, 2, 0).copy(), history / history.sum(),
        mean.reshape(dropped, kept, 2), cov.reshape(dropped, kept, 2, 2))


def move_radius(motion: MotionModes, sensor: SensorModel) -> int:
    """Return how many cells an object moves at most in a frame, along an axis."""
    return max(1, math.ceil(motion.max_speed_mps * sensor.frame_period_s / sensor.cell_size_m))


def shifted(plane: np.ndarray, move: np.ndarray, fill: float) -> np.ndarray:
    """Return a plane (..., rows, cols) moved by (rows, cols); cells that enter are ``fill``."""
    result = np.full_like(plane, fill)
    target, source = zip(*(_slices(int(step)) for step in move), strict=True)
    result[(..., *target)] = plane[(..., *source)]
    return result


def _slices(step: int) -> tuple[slice, slice]:
    if step >= 0:
        return slice(step, None), slice(None, -step or None)
    return slice(None, step), slice(-step, None)


def best_vicinity(
    plane: np.ndarray, moves: np.ndarray, log_prob: np.ndarray, regions: int = 1,
) -> np.ndarray:
    """
    Return the largest value that may move into each cell, with the log probability of its move.

    Parameters
    ----------
    plane : (..., rows, cols) ndarray
        Values before the move; outside the frame counts as -inf.
    moves : (n, 2) ndarray of int
        Rows and columns of each move.
    log_prob : (n,) or (n, rows, cols) ndarray
        Log probability of the move, by the cell it starts in [nat].
    regions
        Sub-regions that are processed in parallel.

    Returns
    -------
    (..., rows, cols) ndarray
        ``max over moves (plane before the move + log_prob)``.

    """
    added = np.ascontiguousarray(log_prob, dtype=plane.dtype)
    added = added.reshape(len(moves), *(added.shape[1:] or (1, 1)))
    planes = np.ascontiguousarray(plane).reshape(-1, *plane.shape[-2:])
    best = np.empty_like(planes)
    rows = plane.shape[-2]
    in_bands(
        lambda first, last: best_moves(planes, moves, added, first, last, best), rows, regions)
    return best.reshape(plane.shape)


def vicinity_max(plane: np.ndarray, radius: int) -> np.ndarray:
    """
    Return the largest value within ``radius`` cells in both directions.

    Parameters
    ----------
    plane : (..., rows, cols) ndarray
        Values; outside the frame counts as -inf.
    radius
        Cells on each side.

    Returns
    -------
    (..., rows, cols) ndarray
        Maximum over the (2 radius + 1)^2 cells around each cell.

    """
    for axis in (-1, -2):
        source = np.moveaxis(plane, axis, -1)
        widest = source.copy()
        for shift in range(1, min(radius, source.shape[-1] - 1) + 1):
            np.maximum(widest[..., shift:], source[..., :-shift], out=widest[..., shift:])
            np.maximum(widest[..., :-shift], source[..., shift:], out=widest[..., :-shift])
        plane = np.moveaxis(widest, -1, axis)
    return plane


def _simulated_moves(
    motion: MotionModes, sensor: SensorModel, steps: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Return moves (samples, steps, 2) and the velocity before the last, (samples, 2)."""
    rng = np.random.default_rng(_SEED)
    states = np.empty((_SAMPLES, 4))
    states[:, POS] = sensor.cell_size_m * rng.uniform(-0.5, 0.5, (_SAMPLES, 2))
    states[:, VEL] = motion.draw_velocity((_SAMPLES,), rng)
    modes = rng.integers(motion.count, size=_SAMPLES)
    cells = [sensor.cells(states)]
    for _ in range(steps):
        velocity = states[:, VEL]
        modes = motion.switch(modes, sensor.frame_period_s, rng)
        states = motion.move(states, modes, sensor.frame_period_s, rng)
        cells.append(sensor.cells(states))
    return np.diff(np.stack(cells, axis=1), axis=1), velocity


def _moments(
    velocity: np.ndarray, group: np.ndarray, groups: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean (groups, 2) and covariance (groups, 2, 2); those of all for an empty group."""
    def sums(values: np.ndarray) -> np.ndarray:
        return np.asarray(np.bincount(group, weights=values, minlength=groups) + values.mean())

    weight = sums(np.ones(len(group)))
    mean = np.stack([sums(v) for v in velocity.T], axis=-1) / weight[:, None]
    second = np.stack([
        np.stack([sums(a * b) for b in velocity.T], axis=-1) for a in velocity.T], axis=-1)
    return mean, second / weight[:, None, None] - mean[:, :, None] * mean[:, None, :]
