# SPDX-License-Identifier: Apache-2.0
"""What the conditioner carries from frame to frame, and what it returns for each."""

from __future__ import annotations

from dataclasses import dataclass

from lowsnr_sensor.conditioning.pixels import Planes
import numpy as np


@dataclass(frozen=True)
class ConditionerState:
    """
    What the conditioner carries from frame to frame.

    Parameters
    ----------
    shape
        Rows and columns of the frames.
    planes
        Level, variance and age of the pixels of the scene; None before the first good frame.
    local : (rows // 4, cols // 4) ndarray
        Variance of the surroundings; zeros before the second frame.
    previous : (rows, cols) ndarray
        The frame before.
    spectrum
        Spectrum of that frame for the registration; None if it was not needed.
    position
        Row and column of the image in the planes [pixels].
    origin
        Row and column of the planes in the scene [cells].
    frames
        Good frames since the start, or since the scene was changed.
    moved
        Frames since the camera moved.
    rejected
        Frames without content since the last good one.
    codec
        Share of recent frames that look like compressed video.
    activity
        Mean square of recent frames in units of the expected noise.
    copies : (rows, cols) ndarray of uint8
        How often the codec copied each pixel, frame after frame; zeros without a codec.
    before : (rows // binning, cols // binning) ndarray
        Matched-filtered cells of the frame before, without a limit.
    trace : (rows // binning, cols // binning) ndarray
        Fading sum of cells; ``trace_variance`` is its variance for white noise.
    cell_variance : (blocks, blocks) ndarray
        Variance of the cells around each block; from ``cell_frames`` frames.

    """

    shape: tuple[int, int]
    planes: Planes | None
    local: np.ndarray
    previous: np.ndarray
    copies: np.ndarray
    before: np.ndarray
    trace: np.ndarray
    cell_variance: np.ndarray
    spectrum: np.ndarray | None = None
    position: tuple[float, float] = (0.0, 0.0)
    origin: tuple[int, int] = (0, 0)
    frames: int = 0
    moved: int = 1000
    rejected: int = 0
    codec: float = 0.0
    activity: float = 1.0
    trace_variance: float = 0.0
    cell_frames: int = 0


@dataclass(frozen=True)
class Conditioned:
    """
    A conditioned frame.

    Parameters
    ----------
    cells : (rows // binning, cols // binning) ndarray of float32
        Cells in standard deviations of their noise, in scene coordinates; zeros where nothing is
        observed, or the background is not known yet.
    event
        What is unusual about the frame: ``start``, ``cut`` (another scene: everything starts
        anew), ``flat``, ``saturated``, ``blank`` (no content: zeros, the frame is ignored), or
        nothing.
    origin
        Row and column of cell (0, 0) in the scene [cells].
    shift
        By how many cells the origin moved at this frame; memories of cells move the other way.
    to_image
        Motion scene to image: column and row of the image are those of the scene plus this
        [pixels].
    gain, offset
        The frame over the background, before the frame was corrected.
    noise_floor
        Least standard deviation of a pixel [units of the frame].

    """

    cells: np.ndarray
    event: str = ''
    origin: tuple[int, int] = (0, 0)
    shift: tuple[int, int] = (0, 0)
    to_image: tuple[float, float] = (0.0, 0.0)
    gain: float = 1.0
    offset: float = 0.0
    noise_floor: float = 0.0
