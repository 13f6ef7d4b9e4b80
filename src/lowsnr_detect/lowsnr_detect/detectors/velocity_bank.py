# SPDX-License-Identifier: Apache-2.0
"""
BANK: shift and add along constant velocities, what moves against what stands in place.

For each of V velocities v, in cells a frame, the frames are added along its motion; with the
fading f and with d_k = round(k v) - round((k - 1) v), the whole cells that it moves by in frame k,
and z limited to ``limit`` sigma ::

    S_k^v(c) = f S_{k-1}^v(c - d_k) + z_k(c) / sigma                          (shift and add)
    D_k^v(c) = S_k^v(c) - g S_k^0(c),      u_k(c) = max over v of D_k^v(c) / std D_k^v

g is the weight of what stands in place: an edge or a pixel that stays above its background adds
to S^0 as to every slow S^v, and takes itself out.  In other than normal noise z / sigma is the
log-likelihood ratio of the cell, standardised.  u is normal for white noise of each velocity,
and ``u^2 / 2`` (u > 0) is the log-likelihood ratio of an object of unknown intensity, maximised
over the intensity; the statistic therefore does not depend on a design SNR.  Objects slower than
about a tenth of a cell a frame take themselves out: a path test (SDT, CUSUM) finds those.

The velocities are the points of a square grid in a disc.  Shifts are whole cells, so that
nothing is interpolated and the noise stays white.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace
import functools
import math
from typing import ClassVar

from lowsnr_common.images.bands import in_bands
from lowsnr_common.settings.declare import setting
from lowsnr_detect.parts.bank_kernels import extend_bank
from lowsnr_detect.parts.bank_kernels import LARGEST
from lowsnr_detect.parts.cell_detector import CellDetector
from lowsnr_detect.parts.detector import CORRELATED_FRAMES
from lowsnr_detect.parts.moves import shifted
from lowsnr_detect.parts.registry import register
import numpy as np

# Older frames weigh less than f^k < 1e-4 of the newest in the variance of a sum.
_LEAST_WEIGHT = 1e-4
# Beyond so many standard deviations a sum is cut, so that the step it is stored in stays small.
_MOST_SUM = 256.0


@functools.cache
def velocity_grid(fastest: float, rings: int) -> np.ndarray:
    """
    Return the velocities (V, 2) in rows and columns a frame, slowest first, so zero first.

    They are the points with spacing ``fastest / rings`` of a disc: 49 for four rings.
    """
    axis = np.arange(-rings, rings + 1)
    points = np.stack(np.meshgrid(axis, axis, indexing='ij'), -1).reshape(-1, 2)
    square = np.sum(points**2, axis=1)
    order = np.argsort(square, kind='stable')
    return np.asarray(points[order[square[order] <= rings**2]] * (fastest / rings))


def places(velocity: np.ndarray, frame: int | np.ndarray) -> np.ndarray:
    """Return round(k v), (V, 2) of int, for frame number k; (..., V, 2) for (..., 1, 1) of k."""
    return np.floor(velocity * frame + 0.5).astype(np.intp)


def shift_and_add(
    sums: np.ndarray, frame: np.ndarray, moves: np.ndarray, std: np.ndarray, fading: float,
    standing: float,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return S_k of every velocity and u_k: the definition, in NumPy.

    Parameters
    ----------
    sums : (V, ..., rows, cols) ndarray
        S_{k-1}; the first velocity is zero.
    frame : (..., rows, cols) ndarray
        z_k / sigma, limited.
    moves : (V, 2) ndarray of int
        d_k of each velocity.
    std : (V,) ndarray
        Standard deviation of D_k for white noise.
    fading, standing
        f and g.

    """
    moved = np.stack([shifted(each, move, 0.0) for each, move in zip(sums, moves, strict=True)])
    S = fading * moved + frame
    D = S - standing * S[0]
    u = np.max([d / s for d, s in zip(D[1:], std[1:], strict=True)], axis=0)
    return S, u


@dataclass(frozen=True)
class BankSums:
    """
    S_k of every velocity, and the number k of frames that are not blank.

    Parameters
    ----------
    stored : (..., rows, V, cols) ndarray of int16
        S_k in whole numbers of ``step``.
    step
        Unit of the stored numbers [standard deviations of the noise].
    frame
        k.

    """

    stored: np.ndarray
    step: float
    frame: int

    @property
    def sums(self) -> np.ndarray:
        """Return S_k, (V, ..., rows, cols) of float32."""
        return np.moveaxis(self.stored, -2, 0) * np.float32(self.step)

    def moved(self, by: tuple[int, int], cell_size_m: float) -> BankSums:
        """Return the memory for cells whose first one moved ``by`` rows and columns."""
        planes = shifted(np.moveaxis(self.stored, -2, -3), np.negative(by), 0)
        return replace(self, stored=np.ascontiguousarray(np.moveaxis(planes, -3, -2)))


@register('bank')
@dataclass(frozen=True, kw_only=True)
class VelocityBank(CellDetector):
    """Declare the cells with ``u_k^2 / 2`` above the threshold."""

    centroid_reach: ClassVar[int] = 2
    # A sum keeps half of its excess for four frames, in which a path departs by twice its speed.
    shadow_reach: ClassVar[int] = 8

    fastest: float = setting(
        1.5, 'speed of the fastest velocity [cells a frame]', gt=0.0, le=16.0)
    rings: int = setting(
        4, 'speeds along each axis: 1, 2, 3, 4 rings are 5, 13, 29, 49 velocities', ge=1, le=12)
    fading: float = setting(
        0.85, 'f, the weight of a sum from a frame to the next', ge=0.0, lt=1.0)
    standing: float = setting(
        0.5, 'g, the share that is subtracted of what stands in place', ge=0.0, lt=1.0)
    limit: float = setting(
        8.0, 'limit of the magnitude of a cell [standard deviations]', gt=0.0)
    thinning_reach: int = setting(
        3, 'cells on each side that a stronger declaration suppresses', ge=0, le=50)
    regions: int = setting(
        1, 'sub-regions of the frame that are processed in parallel; the result is the same',
        ge=1, le=64)

    @property
    def halo(self) -> int:
        """
        Return how far the fastest velocity comes from while a frame weighs 1e-4 or more.

        Note: older frames change a sum by less than the step in which it is stored.
        """
        return math.ceil(self.fastest * (1 + self._remembered))

    @property
    def _remembered(self) -> int:
        """Return the frames after which one weighs less than 1e-4."""
        return 0 if self.fading == 0.0 else int(np.log(_LEAST_WEIGHT) / np.log(self.fading))

    @property
    def frames_per_declaration(self) -> int:
        """Return the number of frames over which errors of declarations are correlated."""
        return CORRELATED_FRAMES

    @property
    def velocity(self) -> np.ndarray:
        """Return the velocities, (V, 2) in rows and columns a frame, the first of them zero."""
        return velocity_grid(self.fastest, self.rings)

    @property
    def step_std(self) -> float:
        """Return the step in which sums are stored: the largest possible sum is a whole number."""
        return min(self.limit / (1.0 - self.fading), _MOST_SUM) / LARGEST

    def init(self, shape: tuple[int, ...]) -> BankSums:
        """Return the sums before the first frame of shape (..., rows, cols)."""
        *runs, rows, cols = shape
        stored = np.zeros((*runs, rows, len(self.velocity), cols), np.int16)
        return BankSums(stored, self.step_std, 0)

    def statistic(
        self, state: BankSums, frame: np.ndarray,
    ) -> tuple[BankSums, np.ndarray]:
        """Return the memory after a frame and ``u^2 / 2`` of every cell [nat]."""
        number = state.frame + 1
        if number == 1 and not frame.any():
            return state, np.zeros(frame.shape, np.float32)
        z = np.asarray(self.sensor.standardised(np.asarray(frame, np.float32)), np.float32)
        plane = np.clip(z, -self.limit, self.limit, out=z).reshape(-1, *frame.shape[-2:])
        before = state.stored.reshape(len(plane), -1, *state.stored.shape[-2:])
        stored, best = np.empty_like(before), np.empty_like(plane)
        moves = places(self.velocity, number) - places(self.velocity, number - 1)
        scale = (1.0 / self.std(number)).astype(np.float32)
        step, fading, standing = map(np.float32, (state.step, self.fading, self.standing))
        in_bands(
            lambda first, last: extend_bank(
                before, plane, moves, scale, step, fading, standing, first, last, stored, best),
            plane.shape[1], self.regions)
        return (replace(state, stored=stored.reshape(state.stored.shape), frame=number),
                best.reshape(frame.shape))

    def std(self, frame: int) -> np.ndarray:
        """Return the standard deviation of D_k for white noise, (V,), in frame number k."""
        back = np.arange(min(frame, self._remembered + 1))
        stays = np.all(
            places(self.velocity, (frame - back)[:, None, None]) == places(self.velocity, frame),
            axis=-1)
        # A frame in which the path is where the object would stand counts 1 - g, any other both.
        square = np.where(stays, (1.0 - self.standing)**2, 1.0 + self.standing**2)
        return np.asarray(np.sqrt(np.sum(self.fading**(2 * back)[:, None] * square, axis=0)))
