# SPDX-License-Identifier: Apache-2.0
"""
Compressed video: how it is recognised, and what is known of pixels that the codec copies.

A codec sends what changes, and copies the rest of a frame from the one before: such a pixel is no
measurement.  What a passing object leaves behind stays until the next complete frame.
"""

from __future__ import annotations

from typing import Protocol

from lowsnr_sensor.conditioning.pixels import moved_by
from lowsnr_sensor.conditioning.pixels import Planes
import numpy as np

# Share of recent frames above which they are taken for compressed video.
CODED = 0.5
# A codec leaves pixels as they were, neighbours together: share of such, and the factor by which
# changes of neighbours are more frequent together than they were if independent.
_STILL, _TOGETHER = 0.5, 2.5
# Successive copies of a pixel after which its level follows, and the step it takes.  Pixels of an
# object that moves by .2 pixel a frame are copied up to three times in a row.
_COPIES, _STEP = 4, 0.3


class Past(Protocol):
    """What is known of the frames before."""

    @property
    def codec(self) -> float:
        """Return the share of recent frames that look like compressed video."""

    @property
    def position(self) -> tuple[float, float]:
        """Return row and column of the frame before in the planes [pixels]."""

    @property
    def previous(self) -> np.ndarray:
        """Return the frame before."""

    @property
    def copies(self) -> np.ndarray:
        """Return how often the codec copied each pixel, until the frame before."""


def looks_coded(
    past: Past, values: np.ndarray, position: tuple[float, float], step: int,
) -> bool:
    """Return whether frame and the one before, where they overlap, look like compressed video."""
    down, right = _motion(past, position)
    rows, cols = values.shape
    if abs(down) > rows // 2 or abs(right) > cols // 2:
        return past.codec > CODED
    now = values[max(-down, 0):rows - max(down, 0), max(-right, 0):cols - max(right, 0)]
    before = past.previous[max(down, 0):rows + min(down, 0), max(right, 0):cols + min(right, 0)]
    return is_codec(now, before, step)


def is_codec(frame: np.ndarray, before: np.ndarray, step: int) -> bool:
    """
    Return whether two frames look like compressed video.

    Pixels stand still there, and those that change do so together with their neighbours; where
    noise is below one grey step, pixels stand still too, but change independently.

    """
    left, right = (
        frame[::step, start:frame.shape[1] - 1 + start:step]
        != before[::step, start:frame.shape[1] - 1 + start:step] for start in (0, 1))
    changed = (left.mean() + right.mean()) / 2.0
    if not 0.0 < changed < 1.0 - _STILL:
        return bool(changed == 0.0)
    return bool((left & right).mean() > _TOGETHER * changed**2)


def counted(
    past: Past, values: np.ndarray, position: tuple[float, float], codec: float,
) -> np.ndarray:
    """Return in how many frames up to this the codec copied each pixel, (rows, cols) of uint8."""
    if codec <= CODED:
        return np.zeros(values.shape, np.uint8)
    count, before, motion = past.copies, past.previous, _motion(past, position)
    if any(motion):
        count, before = moved_by(count, motion, 0), moved_by(before, motion, np.nan)
    return np.where(values == before, np.minimum(count, 254) + 1, 0).astype(np.uint8)


def settled(planes: Planes, values: np.ndarray, count: np.ndarray) -> Planes:
    """Return the planes with levels nearer to pixels that the codec has copied for long."""
    nearer = planes.level + np.float32(_STEP) * (values - planes.level)
    return planes._replace(level=np.where(count >= _COPIES, nearer, planes.level))


def _motion(past: Past, position: tuple[float, float]) -> tuple[int, int]:
    """Return by how many pixels the image moved."""
    down, right = (round(place - before) for place, before in zip(position, past.position))
    return down, right
