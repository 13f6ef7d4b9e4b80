# SPDX-License-Identifier: Apache-2.0
"""
Transitions of the point-mass filter: points finer than cells, headings, speeds and modes.

A class is a mode, a heading and a speed, each of the latter two an interval.  Objects are drawn
uniformly in an interval of both and around a point, moved by the motion model, and the classes
and points they come to are counted.  Transitions with less than 0.4 % of the objects are dropped
and the others scaled to a sum of one: an object that makes a rare step counts as one that makes
a common one.
"""

from __future__ import annotations

import functools

from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_detect.grid.transitions import grouped
from lowsnr_detect.grid.transitions import Transitions
import numpy as np

# Objects of each heading and speed: the standard error of a probability is at most 0.008, and
# 0.001 at the bound below which they are dropped.
_SAMPLES = 4096
_SEED = 0
# Transitions below this are dropped, and so is none above a twentieth of the most probable.
_LEAST_PROB, _LEAST_SHARE = 0.004, 0.05


@functools.lru_cache(maxsize=16)
def point_transitions(
    motion: MotionModes, spacing_m: float, period_s: float, headings: int, speeds: int,
) -> Transitions:
    """
    Count the transitions of simulated objects.

    Parameters
    ----------
    motion
        How objects move.
    spacing_m
        Distance of neighbouring points [m].
    period_s
        Time from a frame to the next [s].
    headings, speeds
        Intervals of the heading, all around, and of the speed an object appears with; the
        outermost ones hold all lower and higher speeds too.

    """
    rng, kinds = np.random.default_rng(_SEED), headings * speeds
    states = _drawn(motion, spacing_m, headings, speeds, rng)
    columns = []
    for mode in range(motion.count):
        moved = motion.move(
            states.reshape(1, -1, 4), np.full((1, kinds * _SAMPLES), mode), period_s,
            rng).reshape(states.shape)
        target = _kinds(motion, moved[..., VEL], headings, speeds)
        step = np.floor(moved[..., POS[::-1]] / spacing_m + 0.5).astype(int)
        source, target, step, prob = _counted(target, step)
        columns.append((source + kinds * mode, target + kinds * mode, step, prob))
    source, target, step, prob = (np.concatenate(part) for part in zip(*columns))
    velocity = states[..., VEL]
    offset = velocity - velocity.mean(axis=1, keepdims=True)
    count = kinds * motion.count
    return Transitions(
        **grouped(source, target, step, prob, count),
        switch=motion.mode_transition(period_s),
        appears=np.full(count, 1.0 / count),
        velocity=np.tile(velocity.mean(axis=1), (motion.count, 1)),
        velocity_cov=np.tile(
            offset.swapaxes(1, 2) @ offset / _SAMPLES, (motion.count, 1, 1)))


def _drawn(
    motion: MotionModes, spacing_m: float, headings: int, speeds: int, rng: np.random.Generator,
) -> np.ndarray:
    """Return states (headings * speeds, samples, 4) around the point 0, speed fastest."""
    states = np.empty((headings, speeds, _SAMPLES, 4))
    states[..., POS] = spacing_m * rng.uniform(-0.5, 0.5, (*states.shape[:3], 2))
    part = np.arange(speeds)[:, None] + rng.random(states.shape[:3])
    span = motion.max_speed_mps - motion.min_speed_mps
    speed = motion.min_speed_mps + span * part / speeds
    turn = np.arange(headings)[:, None, None] + rng.uniform(-0.5, 0.5, states.shape[:3])
    heading = 2.0 * np.pi / headings * turn
    states[..., VEL[0]], states[..., VEL[1]] = speed * np.cos(heading), speed * np.sin(heading)
    return states.reshape(-1, _SAMPLES, 4)


def _kinds(
    motion: MotionModes, velocity: np.ndarray, headings: int, speeds: int,
) -> np.ndarray:
    """Return the number of the heading and speed of velocities (..., 2)."""
    turn = np.arctan2(velocity[..., 1], velocity[..., 0]) / (2.0 * np.pi) * headings
    heading = np.floor(turn + 0.5).astype(int) % headings
    span = motion.max_speed_mps - motion.min_speed_mps
    above = np.linalg.norm(velocity, axis=-1) - motion.min_speed_mps
    part = np.floor(speeds * above / span) if span > 0.0 else np.zeros(above.shape)
    return np.asarray(heading * speeds + part.clip(0, speeds - 1).astype(int))


def _counted(
    target: np.ndarray, step: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return source, target, step and probability of the transitions of objects (kinds, n)."""
    kinds, reach = len(target), int(abs(step).max())
    side = 2 * reach + 1
    source = np.arange(kinds)[:, None]
    place = ((source * kinds + target) * side + step[..., 0] + reach) * side + step[..., 1] + reach
    found, counts = np.unique(place, return_counts=True)
    prob = counts / target.shape[1]
    rest, across = np.divmod(found, side)
    rest, down = np.divmod(rest, side)
    origin, into = np.divmod(rest, kinds)
    largest = np.maximum.reduceat(prob, np.searchsorted(origin, np.arange(kinds)))
    kept = prob >= np.minimum(_LEAST_PROB, _LEAST_SHARE * largest)[origin]
    return (origin[kept], into[kept], np.stack([down, across], axis=-1)[kept] - reach,
            prob[kept])
