# SPDX-License-Identifier: Apache-2.0
"""The planes of the scene seen from the image, and back."""

from __future__ import annotations

from dataclasses import replace

from lowsnr_sensor.conditioning import scene_kernels
from lowsnr_sensor.conditioning.frame_fit import FrameFit
from lowsnr_sensor.conditioning.pixels import BLOCK
from lowsnr_sensor.conditioning.pixels import Change
from lowsnr_sensor.conditioning.pixels import moved_by
from lowsnr_sensor.conditioning.pixels import Planes
from lowsnr_sensor.conditioning.registration import cubic
from lowsnr_sensor.conditioning.registration import whole_and_fraction
from lowsnr_sensor.conditioning.state import ConditionerState
import numpy as np


def follow(
    state: ConditionerState, fit: FrameFit, slack: int, binning: int,
) -> tuple[ConditionerState, tuple[int, int]]:
    """
    Put the image at its place in the planes; if it has left them too far, move these.

    They move by whole blocks of cells, and what leaves them is forgotten.

    Returns
    -------
    ConditionerState
        With the new position.
    tuple
        By how many rows and columns of cells the planes moved.

    """
    state = replace(
        state, position=fit.position, codec=fit.codec, moved=fit.moved,
        spectrum=fit.spectrum,
        local=fit.local if not state.local.any() else state.local)
    if max(abs(place) for place in fit.position) <= slack:
        return state, (0, 0)
    unit = BLOCK * binning
    blocks = [round(place / unit) for place in fit.position]
    down, right = (BLOCK * count for count in blocks)
    assert state.planes is not None
    pixels = (binning * down, binning * right)
    return replace(
        state,
        planes=Planes(*(moved_by(plane, pixels, 0.0) for plane in state.planes)),
        local=blocks_moved_by(state.local, (binning * blocks[0], binning * blocks[1])),
        before=moved_by(state.before, (down, right), 0.0),
        trace=moved_by(state.trace, (down, right), 0.0),
        cell_variance=blocks_moved_by(state.cell_variance, (blocks[0], blocks[1])),
        position=(fit.position[0] - pixels[0], fit.position[1] - pixels[1]),
        origin=(state.origin[0] + down, state.origin[1] + right)), (down, right)


def blocks_moved_by(blocks: np.ndarray, by: tuple[int, int]) -> np.ndarray:
    """Return ``blocks[i + row, j + col]``; the border goes on beyond it."""
    places = (
        np.clip(np.arange(size) + step, 0, size - 1) for size, step in zip(blocks.shape, by))
    moved: np.ndarray = blocks[np.ix_(*places)]
    return moved


def shifted(plane: np.ndarray, position: tuple[float, float]) -> np.ndarray:
    """Return ``plane(i + row, j + col)``, by cubic interpolation; the border goes on beyond it."""
    for axis, place in enumerate(position):
        whole, fraction = whole_and_fraction(place)
        at = np.arange(plane.shape[axis]) + whole
        plane = sum(
            weight * np.take(plane, np.clip(at + tap - 1, 0, len(at) - 1), axis)
            for tap, weight in enumerate(cubic(fraction)))
    return plane


def shifted_compiled(plane: np.ndarray, position: tuple[float, float]) -> np.ndarray:
    """Compute :func:`shifted` by a compiled loop."""
    (row, down), (col, right) = (whole_and_fraction(place) for place in position)
    out = np.empty_like(plane)
    scene_kernels.shift(plane, row, col, cubic(down), cubic(right), out)
    return out


def to_image(state: ConditionerState) -> tuple[Planes, tuple[int, int]]:
    """Return the planes in the pixels of the image, and the pixel of the planes it starts in."""
    assert state.planes is not None
    if state.position == (0.0, 0.0):
        return state.planes, (0, 0)
    corner = _nearest(state)
    return Planes(
        shifted_compiled(state.planes.level, state.position),
        moved_by(state.planes.variance, corner, 0.0),
        moved_by(state.planes.age, corner, 0.0)), corner


def from_image(
    state: ConditionerState, before: Planes, after: Planes, change: Change,
) -> Planes:
    """
    Return the planes of the scene after those of the image changed.

    What the level changed by is interpolated, and not the level, which would blur from frame to
    frame.
    """
    assert state.planes is not None
    if state.position == (0.0, 0.0):
        return after
    out = Planes(*(np.empty_like(plane) for plane in after))
    scalars = (np.float32(change.gain), np.float32(change.offset))
    row, col = _nearest(state)
    (top, down), (left, right) = (whole_and_fraction(-place) for place in state.position)
    scene_kernels.to_scene(
        tuple(state.planes), (before.level, before.age), tuple(after), scalars, (-row, -col),
        (top, left), (np.float32(down), np.float32(right)), tuple(out))
    return out


def from_image_defined(
    state: ConditionerState, before: Planes, after: Planes, change: Change,
) -> Planes:
    """Define :func:`from_image` in NumPy."""
    assert state.planes is not None
    old, known = state.planes, state.planes.age > 0.0
    expected = change.gain * before.level + change.offset
    step = np.where(before.age > 0.0, after.level - expected, 0.0)
    row, col = _nearest(state)
    age = moved_by(after.age, (-row, -col), -1.0)
    inside = age >= 0.0
    level = change.gain * old.level + change.offset
    fresh = np.where(known, level + _linear(step, state.position),
                     _linear(after.level, state.position))
    return Planes(
        np.where(inside, fresh, level),
        np.where(inside, moved_by(after.variance, (-row, -col), 0.0), old.variance),
        np.where(inside, age, old.age))


def _linear(plane: np.ndarray, position: tuple[float, float]) -> np.ndarray:
    """Return ``plane(i - row, j - col)`` by linear interpolation; its border goes on beyond it."""
    for axis, place in enumerate(position):
        whole, part = whole_and_fraction(-place)
        at, last = np.arange(plane.shape[axis]) + whole, plane.shape[axis] - 1
        plane = ((1.0 - part) * np.take(plane, np.clip(at, 0, last), axis)
                 + part * np.take(plane, np.clip(at + 1, 0, last), axis))
    return plane


def _nearest(state: ConditionerState) -> tuple[int, int]:
    return round(state.position[0]), round(state.position[1])
