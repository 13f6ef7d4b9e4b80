# SPDX-License-Identifier: Apache-2.0
"""
Conditioning: from real frames to white noise of standard deviation one, plus objects.

A real frame has a background, noise that differs from place to place, changes of level and gain,
stripes, and single pixels hit by particles; and the camera may move.  The conditioner finds where
the frame lies in the scene and what changed in it as a whole, subtracts the level of each pixel,
divides by its noise and limits it, applies a matched filter, bins pixels to cells, subtracts the
mean of their surroundings, and divides each cell by its noise.  It keeps no past frames but the
last: level and noise are recursive.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace
import functools
import math
from typing import Any

from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.records import Malformed
from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import setting
from lowsnr_sensor.conditioning import compiled_steps as steps
from lowsnr_sensor.conditioning.cells import taps
from lowsnr_sensor.conditioning.codec import CODED
from lowsnr_sensor.conditioning.codec import counted
from lowsnr_sensor.conditioning.codec import settled
from lowsnr_sensor.conditioning.frame_change import with_stripes
from lowsnr_sensor.conditioning.frame_fit import fit_frame
from lowsnr_sensor.conditioning.frame_fit import FrameFit
from lowsnr_sensor.conditioning.frame_fit import with_noise
from lowsnr_sensor.conditioning.frame_fit import without_content
from lowsnr_sensor.conditioning.pixels import blocks_of
from lowsnr_sensor.conditioning.pixels import Limits
from lowsnr_sensor.conditioning.pixels import Planes
from lowsnr_sensor.conditioning.pixels import some
from lowsnr_sensor.conditioning.pixels import UNOBSERVED
from lowsnr_sensor.conditioning.scene import follow
from lowsnr_sensor.conditioning.scene import from_image
from lowsnr_sensor.conditioning.scene import to_image
from lowsnr_sensor.conditioning.state import Conditioned
from lowsnr_sensor.conditioning.state import ConditionerState
from lowsnr_sensor.conditioning.whitening import whitened
import numpy as np

# Limit of the update of the level [standard deviations].
_LEVEL_LIMIT = 2.0
# Pixels by which an object, and its image in cells, move from frame to frame at most.
_TRANSIENT_REACH = 4
# Frames without content after which they are taken for another scene.
_MOST_REJECTED = 8


@dataclass(frozen=True, kw_only=True)
class ConditioningSettings:
    """Settings of the conditioner, which is the pair of ``init`` and ``step``."""

    background_frames: int = setting(
        64, 'frames over which the level of a pixel is estimated; an object must leave its place '
        'within about a third of them', ge=2, le=1000)
    noise_frames: int = setting(
        100, 'frames over which the noise is estimated', ge=2, le=100_000)
    warm_up_frames: int = setting(
        5, 'frames that a pixel must have been seen in before it counts', ge=1, le=100)
    psf_px: float = setting(
        0.8, 'standard deviation of the point spread of an object [pixels]', gt=0.0, le=10.0)
    binning: int = setting(2, 'pixels along each side of a cell', choices=(1, 2))
    limit: float = setting(
        8.0, 'limit of a pixel before the matched filter [standard deviations]', gt=0.0)
    smoothing_reach: int = setting(
        8, 'pixels on each side of the mean that is subtracted, 0 for none', ge=0, le=500)
    noise_floor: float = setting(
        0.3, 'least standard deviation of the noise of a pixel, in steps of an integer encoding; '
        'a float encoding has no floor', ge=0.0)
    codec_floor: float = setting(
        2.5, 'the same in compressed video, whose codec leaves patterns', ge=0.0)
    jitter_px: float = setting(
        0.35, 'error of the registration, which adds noise to edges of the background [pixels]',
        ge=0.0, le=10.0)
    persistence: float = setting(
        0.5, 'weight from frame to frame in the sum of cells that the noise of cells is estimated '
        'from; noise that stays in place counts for more than white noise', ge=0.0, lt=1.0)
    registration: bool = setting(
        True, 'whether the motion of the camera is followed')
    slack_px: int = setting(
        16, 'pixels by which the image may leave the cells of the scene before these follow',
        ge=8, le=1024)
    regions: int = setting(
        1, 'sub-regions of the frame that are processed in parallel; the result is the same',
        ge=1, le=64)

    def __post_init__(self) -> None:
        check_settings(self)

    def frame_map(
        self, output: Conditioned, frame_id: str, shape: tuple[int, int],
    ) -> FrameMap:
        """Return where the cells of an output lie in its image of shape (rows, cols)."""
        (row, col), (rows, cols) = output.origin, shape
        return FrameMap(frame_id, (cols, rows), self.binning, (col, row), output.to_image)

    def size(self, shape: tuple[int, ...]) -> tuple[int, int]:
        """Return rows and columns of the cells for frames of shape (rows, cols)."""
        return shape[-2] // self.binning, shape[-1] // self.binning

    def init(self, shape: tuple[int, int]) -> ConditionerState:
        """
        Return the state before the first frame of shape (rows, cols).

        Raises
        ------
        Malformed
            If the frames are too small for binning; the reason is ``too small``.

        """
        size = self.size(shape)
        if 0 in size:
            raise Malformed(
                'too small', f'frame of {shape[-1]} x {shape[-2]} pixels is too small')
        return ConditionerState(
            shape=(shape[0], shape[1]), planes=None,
            local=np.zeros(blocks_of(shape), np.float32), previous=np.zeros(shape, np.float32),
            copies=np.zeros(shape, np.uint8), before=np.zeros(size, np.float32),
            trace=np.zeros(size, np.float32), cell_variance=np.ones(blocks_of(size), np.float32))

    def step(
        self, state: ConditionerState, frame: np.ndarray,
    ) -> tuple[ConditionerState, Conditioned]:
        """
        Condition a frame.

        Parameters
        ----------
        state
            State after the frame before.
        frame : (rows, cols) ndarray
            Pixels as recorded; NaN and values beyond 1e30 are not observed.

        Returns
        -------
        ConditionerState
            State after this frame.
        Conditioned
            The conditioned frame.

        Raises
        ------
        Malformed
            If the size differs from that of the frames before; the reason is ``change of size``.

        """
        if frame.shape != state.shape:
            (rows, cols), (height, width) = frame.shape, state.shape
            raise Malformed(
                'change of size',
                f'frame of {cols} x {rows} pixels after frames of {width} x {height}')
        values = np.ascontiguousarray(frame, dtype=np.float32)
        event = without_content(state, frame, values)
        if event == 'flat' and state.rejected >= _MOST_REJECTED:
            return self._start(state, values, 'cut')
        if event:
            return replace(state, rejected=state.rejected + 1), self._output(
                state, np.zeros_like(state.trace), event=event)
        if state.planes is None:
            return self._start(state, values, 'start')
        fit = fit_frame(self, state, values, np.issubdtype(frame.dtype, np.integer))
        if fit.cut:
            return self._start(state, values, 'cut')
        return self._followed(state, values, fit)

    def unobserved(self, state: ConditionerState) -> Conditioned:
        """Return zeros in place of a frame that cannot be used."""
        return self._output(state, np.zeros_like(state.trace))

    def _start(
        self, state: ConditionerState, values: np.ndarray, event: str,
    ) -> tuple[ConditionerState, Conditioned]:
        """
        Start from a frame.

        After a cut the scene is another one: it lies where no earlier image reached.
        """
        known = abs(values) < UNOBSERVED
        level = np.where(known, values, np.median(values[known])).astype(np.float32)
        row, col = state.origin
        started = replace(
            self.init(state.shape), previous=values, frames=1, codec=state.codec,
            origin=(row + state.trace.shape[0] * (event == 'cut'), col),
            planes=Planes(level, np.zeros_like(level), known.astype(np.float32)))
        return started, self._output(started, np.zeros_like(started.trace), event=event)

    def _followed(
        self, state: ConditionerState, values: np.ndarray, fit: FrameFit,
    ) -> tuple[ConditionerState, Conditioned]:
        """Condition a frame whose place in the scene and whose change are known."""
        copies = counted(state, values, fit.position, fit.codec)
        state, shift = follow(state, fit, self.slack_px, self.binning)
        state, deviations = self._updated(replace(state, copies=copies), values, fit)
        state, flat = self._filtered(state, deviations)
        state, cells = whitened(
            state, flat, self.persistence, self.noise_frames, self.regions)
        return state, self._output(
            state, cells, shift=shift, gain=fit.change.gain, offset=fit.change.offset,
            noise_floor=fit.floor)

    def _updated(
        self, state: ConditionerState, values: np.ndarray, fit: FrameFit,
    ) -> tuple[ConditionerState, np.ndarray]:
        """Return the state with level and noise after a frame, and the deviations of pixels."""
        limits = Limits(
            self.background_frames, self.noise_frames, self.warm_up_frames, _LEVEL_LIMIT,
            self.limit, fit.floor**2, self.jitter_px)
        before, corner = to_image(state)
        younger = 1.0 + 1.0 / min(state.frames, self.background_frames)
        noise = math.sqrt(max(float(np.median(some(state.local))), fit.floor**2) * younger)
        change = with_stripes(
            fit.change, values, before, noise,
            functools.partial(steps.stripe_sums, regions=self.regions))
        change, activity = with_noise(state, fit, change)
        after, deviations = steps.update(
            values, before, state.local, corner, change, limits, self.regions)
        if state.codec > CODED:
            after = settled(after, values, state.copies)
        planes = from_image(state, before, after, change)
        local = steps.surroundings(
            *steps.block_sums(planes, state.local, self.regions), state.local)
        return replace(
            state, planes=planes, local=local, previous=values, activity=activity,
            frames=state.frames + 1, rejected=0), deviations

    def _filtered(
        self, state: ConditionerState, deviations: np.ndarray,
    ) -> tuple[ConditionerState, np.ndarray]:
        """Return the cells of the matched filter, without transients and what is wide."""
        rows, cols = (
            taps(size, count, self.binning, self.psf_px, place)
            for size, count, place in zip(state.shape, state.trace.shape, state.position))
        cells = steps.filtered(deviations, rows, cols, self.regions)
        steady = steps.transients_limited(
            cells, state.before, _TRANSIENT_REACH // self.binning, self.regions)
        return replace(state, before=cells), steps.flattened(
            steady, self.smoothing_reach // self.binning)

    def _output(self, state: ConditionerState, cells: np.ndarray, **facts: Any) -> Conditioned:
        row, col = (
            place + self.binning * start for place, start in zip(state.position, state.origin))
        return Conditioned(cells, origin=state.origin, to_image=(-col, -row), **facts)
