"""
Conditioning: from real frames to white noise of standard deviation one, plus objects.

A real frame has a background, noise that differs from place to place, and single pixels hit by
particles.  The conditioner subtracts the level of past frames, divides each pixel by its noise and
limits it, subtracts the mean of its surroundings, bins pixels to cells, and divides each cell by
its noise.  All steps are causal: the result depends on this frame and on past ones.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

from lowsnr_common.core.records import Malformed
from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import setting
from lowsnr_sensor.conditioning.background import binned
from lowsnr_sensor.conditioning.background import box_mean
from lowsnr_sensor.conditioning.background import flattened
from lowsnr_sensor.conditioning.background import frame_scale
from lowsnr_sensor.conditioning.background import limited_square
from lowsnr_sensor.conditioning.background import past_level
from lowsnr_sensor.conditioning.background import past_median
from lowsnr_sensor.conditioning.background import steepness
import numpy as np

# The least noise, so that a frame without noise is not divided by zero.
_MIN_NOISE = 1e-12
# The least noise of a cell: where the noise of pixels is at its floor, the cells must not undo it.
_MIN_CELL_NOISE = 0.8
# Iterations in which the first estimate of the noise becomes local.
_FIRST_ROUNDS = 4


@dataclass(frozen=True)
class ConditionerState:
    """
    What the conditioner carries from frame to frame.

    Parameters
    ----------
    history : (n, ..., rows, cols) ndarray
        Past frames, the newest last.
    frames
        Number of frames so far.
    pixel_noise : (..., rows, cols) ndarray
        Noise of a pixel, in units of the frame; None before the first estimate.
    cell_noise : (..., rows // binning, cols // binning) ndarray
        Noise of a cell, in units of that from white noise of its pixels; None likewise.
    trace : (..., rows // binning, cols // binning) ndarray
        Exponentially weighted sum of past cells.
    trace_variance
        Variance of that sum for white noise.

    """

    history: np.ndarray
    frames: int = 0
    pixel_noise: np.ndarray | None = None
    cell_noise: np.ndarray | None = None
    trace: np.ndarray | float = 0.0
    trace_variance: float = 0.0


@dataclass(frozen=True, kw_only=True)
class ConditioningSettings:
    """Settings of the conditioner."""

    background_frames: int = setting(
        31, 'past frames that make the background; an object must leave its place within half '
        'of them', ge=1, le=1000)
    warm_up_frames: int = setting(
        5, 'frames that the background needs before the node publishes more than zeros',
        ge=1, le=1000)
    smoothing_reach: int = setting(
        7, 'pixels on each side of the mean that is subtracted, 0 for none', ge=0, le=500)
    limit: float = setting(
        3.5, 'limit of a pixel before binning [standard deviations]', gt=0.0)
    binning: int = setting(2, 'pixels along each side of a cell', choices=(1, 2))
    noise_reach: int = setting(
        7, 'pixels, and cells, on each side over which the noise is estimated', ge=1, le=500)
    noise_frames: int = setting(
        100, 'frames over which the noise is estimated', ge=1, le=100_000)
    noise_floor: float = setting(
        3.0, 'least standard deviation of the noise of a pixel, in steps of an integer encoding; '
        'a float encoding has no floor', ge=0.0)
    jitter_px: float = setting(
        0.2, 'jitter of the camera, which adds noise to edges of the background [pixels]',
        ge=0.0, le=10.0)
    persistence: float = setting(
        0.5, 'weight from frame to frame in the sum of cells that the noise of cells is estimated '
        'from; noise that stays in place counts for more than white noise', ge=0.0, lt=1.0)

    def __post_init__(self) -> None:
        check_settings(self)
        if self.warm_up_frames > self.background_frames:
            raise ValueError(
                f'ConditioningSettings.warm_up_frames = {self.warm_up_frames}, must be at most '
                f'background_frames = {self.background_frames}')

    def cells(self, pixels: np.ndarray) -> np.ndarray:
        """Convert positions from pixels to cells; the centres of both are whole numbers."""
        return (pixels - (self.binning - 1) / 2.0) / self.binning

    def size(self, shape: tuple[int, ...]) -> tuple[int, int]:
        """Return rows and columns of the cells for frames of shape (..., rows, cols)."""
        return shape[-2] // self.binning, shape[-1] // self.binning

    def init(self, shape: tuple[int, ...]) -> ConditionerState:
        """
        Return the state before the first frame of shape (..., rows, cols).

        Raises
        ------
        Malformed
            If the frames are too small for binning; the reason is ``too small``.

        """
        if 0 in self.size(shape):
            raise Malformed(
                'too small', f'frame of {shape[-1]} x {shape[-2]} pixels is too small')
        return ConditionerState(np.empty((0, *shape), dtype=np.float32))

    def step(
        self, state: ConditionerState, frame: np.ndarray,
    ) -> tuple[ConditionerState, np.ndarray]:
        """
        Condition a frame.

        Parameters
        ----------
        state
            State after the frame before.
        frame : (..., rows, cols) ndarray
            Pixels as recorded; leading axes are independent sequences.

        Returns
        -------
        ConditionerState
            State after this frame.
        (..., rows // binning, cols // binning) ndarray of float32
            Cells in standard deviations of their noise; zeros, in which detectors find nothing,
            until the background is known.

        Raises
        ------
        Malformed
            If the size differs from that of the frames before; the reason is ``change of size``.

        """
        past = state.history
        if frame.shape != past.shape[1:]:
            (rows, cols), (height, width) = frame.shape[-2:], past.shape[-2:]
            raise Malformed(
                'change of size',
                f'frame of {cols} x {rows} pixels after frames of {width} x {height}')
        newest = np.asarray(frame, dtype=np.float32)[None]
        history = np.concatenate([past[max(0, len(past) + 1 - self.background_frames):], newest])
        if len(past) == 0:
            return ConditionerState(history, 1), self._zeros(frame)
        gain = 1.0 / min(state.frames, self.noise_frames)
        whitened, pixel_noise = self._whitened(state, frame, gain)
        cells = binned(flattened(whitened, self.smoothing_reach), self.binning)
        trace = self.persistence * state.trace + cells
        variance = self.persistence**2 * state.trace_variance + 1.0
        cell_noise = self._noise(
            trace / math.sqrt(variance), state.cell_noise, gain, _MIN_CELL_NOISE)
        output = cells / cell_noise if len(past) >= self.warm_up_frames else self._zeros(frame)
        return ConditionerState(
            history, state.frames + 1, pixel_noise, cell_noise, trace, variance,
        ), output.astype(np.float32)

    def _zeros(self, frame: np.ndarray) -> np.ndarray:
        return np.zeros((*frame.shape[:-2], *self.size(frame.shape)), dtype=np.float32)

    def _whitened(
        self, state: ConditionerState, frame: np.ndarray, gain: float,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return limited pixels in units of their noise, and the noise without jitter."""
        floor = self.noise_floor if np.issubdtype(frame.dtype, np.integer) else 0.0
        floor = max(floor, _MIN_NOISE)
        median = past_median(state.history)
        jitter = self.jitter_px * steepness(median)
        noise = state.pixel_noise
        if noise is None:
            noise = np.maximum(frame_scale(frame - median), floor)
        level = past_level(state.history, median, np.hypot(noise, jitter))
        residual = (frame - level) / math.sqrt(1.0 + 1.0 / len(state.history))
        noise = self._noise(residual, state.pixel_noise, gain, floor, jitter)
        return np.clip(residual / np.hypot(noise, jitter), -self.limit, self.limit), noise

    def _noise(
        self, residual: np.ndarray, noise: np.ndarray | None, gain: float, floor: float,
        jitter: np.ndarray | float = 0.0,
    ) -> np.ndarray:
        """Return the noise after a frame, estimated over the surroundings and past frames."""
        rounds = 1
        if noise is None:
            noise, rounds = np.maximum(frame_scale(residual), floor), _FIRST_ROUNDS
        for _ in range(rounds):
            squares = noise**2 * limited_square(residual / np.hypot(noise, jitter))
            now = box_mean(squares, self.noise_reach)
            noise = np.maximum(np.sqrt((1.0 - gain) * noise**2 + gain * now), floor)
        return noise
