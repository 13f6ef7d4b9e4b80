# SPDX-License-Identifier: Apache-2.0
"""
Registration: where the camera looks, as a translation between scene and image.

Phase correlation of two successive frames, reduced to a quarter of their size, gives the first
estimate (Kuglin and Hines 1975).  Gauss-Newton steps refine it against the background, whose
gradient they use, together with offset and gain.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple

from lowsnr_sensor.conditioning import scene_kernels
from lowsnr_sensor.conditioning.pixels import Planes
import numpy as np
import scipy

# Least side of the reduced frames, and the largest factor of the reduction [pixels].
_LEAST_SIDE, _MOST_REDUCED = 64, 4
# Residuals beyond so many standard deviations count as these in the energy of a fit.
_ENERGY_LIMIT = 8.0
# Residuals beyond so many standard deviations have less weight in a fit (Huber).
_FULL_WEIGHT = 3.0
# A motion is accepted if the energy falls by the first factor; or by the second number of standard
# deviations, and the third more, in as many parts of the frame as the fourth of fifth squared.
_FALL, _DEVIATIONS, _MORE, _BETTER_PARTS, _PARTS = 0.8, 4.0, 12.0, 3, 5
# Gauss-Newton steps, their largest [pixels], and that at which they end.
_STEPS, _LARGEST_STEP, _SMALLEST_STEP = 8, 1.0, 0.01


class Sample(NamedTuple):
    """
    Every so many pixels of a frame, with the background and its noise.

    ``values`` are the pixels (rows, cols), ``step`` is their distance, ``noise`` the standard
    deviation of the frame, and ``frames`` the number of frames that the background is a mean of.
    """

    values: np.ndarray
    step: int
    noise: np.ndarray
    frames: int

    def deviation(self, position: tuple[float, float]) -> np.ndarray:
        """
        Return the standard deviation of the difference to the background at a position.

        Interpolation smooths the noise of the background: between pixels the residual of a young
        background is less although nothing fits better.
        """
        kept = math.prod(
            float(np.sum(cubic(whole_and_fraction(place)[1])**2)) for place in position)
        spread: np.ndarray = self.noise * np.float32(math.sqrt(1.0 + kept / self.frames))
        return spread


@dataclass(frozen=True)
class Fit:
    """
    A frame as ``gain * background + offset``, with the image at ``position`` in the scene.

    ``residual`` is what is left, NaN where it is unknown; ``energy`` is its limited mean square in
    units of the noise.  ``background`` are the background and its slopes, (3, n, m).
    """

    position: tuple[float, float]
    gain: float
    offset: float
    residual: np.ndarray
    energy: float
    background: np.ndarray


def cubic(fraction: float) -> np.ndarray:
    """Return the four weights of Catmull-Rom interpolation at 0 <= fraction < 1."""
    t = fraction
    return np.array([
        -t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, -t**2 + t**3,
    ], dtype=np.float32) / np.float32(2.0)


def whole_and_fraction(position: float) -> tuple[int, float]:
    """Return a position as a whole number and a fraction in [0, 1)."""
    whole = math.floor(position)
    return whole, position - whole


def slope(fraction: float) -> np.ndarray:
    """Return the weights of the derivative of that interpolation."""
    t = fraction
    return np.array([
        -1 + 4 * t - 3 * t**2, -10 * t + 9 * t**2, 1 + 8 * t - 9 * t**2, -2 * t + 3 * t**2,
    ], dtype=np.float32) / np.float32(2.0)


def taken(planes: Planes, sample: Sample, position: tuple[float, float]) -> np.ndarray:
    """Return the level and its slopes at the pixels of a sample, (3, n, m); NaN where unknown."""
    axes, plane = [], planes.level
    for place, count, size in zip(position, sample.values.shape, plane.shape):
        whole, part = whole_and_fraction(place)
        at = np.arange(count) * sample.step + whole
        axes.append((at, (at >= 0) & (at < size - 1), cubic(part), slope(part)))
    (rows, high, *down), (cols, wide, *right) = axes
    values = np.zeros((3, *sample.values.shape), dtype=np.float32)
    for tap, other in np.ndindex(4, 4):
        pixels = plane[np.ix_(np.clip(rows + tap - 1, 0, len(plane) - 1),
                              np.clip(cols + other - 1, 0, plane.shape[1] - 1))]
        for number, (one, two) in enumerate(((0, 0), (1, 0), (0, 1))):
            values[number] += down[one][tap] * right[two][other] * pixels
    known = planes.age[np.ix_(rows.clip(0, len(plane) - 1), cols.clip(0, plane.shape[1] - 1))] > 0
    values[:, ~(high[:, None] & wide & known)] = np.nan
    return values


def taken_compiled(
    planes: Planes, sample: Sample, position: tuple[float, float],
) -> np.ndarray:
    """Compute :func:`taken` by a compiled loop."""
    (row, down), (col, right) = (whole_and_fraction(place) for place in position)
    weights = np.stack([[cubic(part), slope(part)] for part in (down, right)])
    values = np.empty((3, *sample.values.shape), dtype=np.float32)
    scene_kernels.sample(planes.level, planes.age, row, col, sample.step, weights, values)
    return values


def fit_level(
    sample: Sample, planes: Planes, position: tuple[float, float], gain: float = 1.0,
) -> Fit:
    """Return the fit at a position that differs in offset alone."""
    background = taken_compiled(planes, sample, position)
    residual = sample.values - gain * background[0]
    known = residual[np.isfinite(residual)]
    offset = float(np.median(known)) if known.size else 0.0
    residual -= np.float32(offset)
    ratio = np.minimum(abs(residual) / sample.deviation(position), _ENERGY_LIMIT)
    ratio = ratio[np.isfinite(ratio)]
    energy = float(np.mean(ratio**2)) if ratio.size else math.inf
    return Fit(position, gain, offset, residual, energy, background)


def refine(
    sample: Sample, planes: Planes, start: Fit, moves: bool, scales: bool,
) -> Fit:
    """Return the best fit near a first one, in offset and in position, gain, or both."""
    best = fit = start
    for _ in range(_STEPS):
        step = _newton_step(sample, fit, moves, scales)
        where = (fit.position[0] + step[0], fit.position[1] + step[1])
        fit = fit_level(sample, planes, where, fit.gain + step[2])
        if fit.energy < best.energy:
            best = fit
        if max(abs(step[0]), abs(step[1])) < _SMALLEST_STEP:
            break
    return best


def is_better(sample: Sample, fit: Fit, still: Fit) -> bool:
    """
    Return whether a motion explains a frame better than none.

    Either the energy falls by 20 %, or it falls, beyond noise, in several parts of the frame and
    rises in few: a bright object that moves does so in one or two.
    """
    if fit.energy < _FALL * still.energy:
        return True
    before, after = (
        np.minimum(abs(item.residual) / sample.deviation(item.position), _ENERGY_LIMIT)**2
        for item in (still, fit))
    # Pixels that either does not know count for none.
    change = np.nan_to_num(before - after)
    for axis, size in enumerate(change.shape):
        change = np.add.reduceat(change, np.unique(np.arange(_PARTS) * size // _PARTS), axis=axis)
    # Noise of the background changes the energy of n pixels by sqrt(8 n / frames).
    noise = _DEVIATIONS * math.sqrt(8.0 * before.size / change.size / sample.frames)
    better, worse = (np.count_nonzero(sign * change > noise + _MORE) for sign in (1, -1))
    return bool(better >= _BETTER_PARTS + 3 * worse)


def _newton_step(
    sample: Sample, fit: Fit, moves: bool, scales: bool,
) -> tuple[float, float, float]:
    """Return the step in row, column and gain of a robust linear least-squares fit."""
    columns = [fit.gain * slope for slope in fit.background[1:]] if moves else []
    if scales:
        columns.append(fit.background[0] - np.nanmean(fit.background[0]))
    known = np.isfinite(fit.residual) & np.isfinite(sum(columns))
    if np.count_nonzero(known) < 8:
        return 0.0, 0.0, 0.0
    ratio = abs(fit.residual[known]) / sample.noise[known]
    weight = _FULL_WEIGHT / np.maximum(ratio, _FULL_WEIGHT) / sample.noise[known]**2
    design = np.stack([*(item[known] for item in columns), np.ones(len(weight))]).astype(float)
    normal = (design * weight) @ design.T
    normal[np.diag_indices_from(normal)] *= 1.0 + 1e-6
    normal[np.diag_indices_from(normal)] += 1e-30
    found = np.linalg.solve(normal, (design * weight) @ fit.residual[known])
    step = np.clip(found[:2], -_LARGEST_STEP, _LARGEST_STEP) if moves else (0.0, 0.0)
    return float(step[0]), float(step[1]), float(found[-2]) if scales else 0.0


def spectrum(frame: np.ndarray) -> np.ndarray:
    """Return the Fourier transform of a frame (rows, cols), reduced and tapered."""
    factor = min(max(min(frame.shape) // _LEAST_SIDE, 1), _MOST_REDUCED)
    transform: np.ndarray = scipy.fft.rfft2(_reduced(frame, factor))
    return transform


def phase_correlation(
    now: np.ndarray, past: np.ndarray, shape: tuple[int, int],
) -> tuple[float, float, float]:
    """
    Return the motion of the camera between frames of a shape, in pixels, and the response.

    ``now`` and ``past`` are the spectra of the frame and of the one before.

    Row and column are those of the image in the scene: content that moves left and up in the
    image gives positive ones.  The response is the height of the peak over that of equal frames.

    """
    factor = shape[0] // len(now)
    size = (shape[0] // factor, shape[1] // factor)
    cross = past * np.conj(now)
    height = abs(cross)
    cross /= height + height.mean() + 1e-30
    surface = scipy.fft.irfft2(cross, s=size)
    peak = np.unravel_index(int(np.argmax(surface)), size)
    full = scipy.fft.irfft2(abs(cross), s=size)[0, 0]
    found = []
    for axis, (place, side) in enumerate(zip(peak, size)):
        line = np.take(np.take(surface, [place - 1, place, (place + 1) % side], axis),
                       peak[1 - axis], 1 - axis)
        bend = line[0] - 2 * line[1] + line[2]
        part = 0.5 * (line[0] - line[2]) / bend if bend < 0 else 0.0
        found.append(factor * ((place + side // 2) % side - side // 2 + part))
    return found[0], found[1], float(surface[peak] / full) if full > 0.0 else 0.0


def _reduced(frame: np.ndarray, factor: int) -> np.ndarray:
    """Return means over squares of a frame, without their mean, with a tapered border."""
    rows, cols = (side // factor for side in frame.shape)
    tall, small = (np.zeros((rows, width), np.float32) for width in (frame.shape[1], cols))
    for start in range(factor):
        tall += frame[start:rows * factor:factor]
    for start in range(factor):
        small += tall[:, start:cols * factor:factor] / np.float32(factor**2)
    small = np.nan_to_num(small - np.nanmean(small), posinf=0.0, neginf=0.0)
    tapers = [np.sqrt(np.hanning(side + 2)[1:-1]).astype(np.float32) for side in (rows, cols)]
    tapered: np.ndarray = small * tapers[0][:, None] * tapers[1]
    return tapered
