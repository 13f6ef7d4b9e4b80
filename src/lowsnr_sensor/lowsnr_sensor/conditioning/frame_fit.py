# SPDX-License-Identifier: Apache-2.0
"""Where a frame lies in the scene, and what changed in it as a whole."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace
import math
from typing import Protocol

from lowsnr_sensor.conditioning import frame_change
from lowsnr_sensor.conditioning.codec import CODED
from lowsnr_sensor.conditioning.codec import looks_coded
from lowsnr_sensor.conditioning.pixels import BLOCK
from lowsnr_sensor.conditioning.pixels import Change
from lowsnr_sensor.conditioning.pixels import own_variance
from lowsnr_sensor.conditioning.pixels import Planes
from lowsnr_sensor.conditioning.pixels import some
from lowsnr_sensor.conditioning.pixels import UNOBSERVED
from lowsnr_sensor.conditioning.registration import Fit
from lowsnr_sensor.conditioning.registration import fit_level
from lowsnr_sensor.conditioning.registration import is_better
from lowsnr_sensor.conditioning.registration import phase_correlation
from lowsnr_sensor.conditioning.registration import refine
from lowsnr_sensor.conditioning.registration import Sample
from lowsnr_sensor.conditioning.registration import spectrum
from lowsnr_sensor.conditioning.state import ConditionerState
import numpy as np

# A gain is accepted if the energy of the residual falls by this factor; a motion beyond the second
# only if the response of the phase correlation is above the third.
_FALL, _NEAR_PX, _RESPONSE = 0.8, 3.0, 0.3
# Energy over the usual one at which a motion is looked for, and frames after a motion, or after
# the start, in which it always is.
_UNUSUAL, _STILL_AFTER, _YOUNG = 1.25, 8, 4
# Least change of gain, and least contrast of the background [standard deviations of the noise].
_LEAST_GAIN, _CONTRAST = 0.01, 3.0
# Another scene: mean square of the residual, and correlation with the background.
_CUT_ENERGY, _CUT_CORRELATION = 3.0, 0.3
# The background is stale: mean square of the residual, and share of it from frame to frame.
_STALE_ENERGY, _STALE = 1.5, 0.3
# A frame is flat if its spread is below this share of what is expected.
_FLAT = 0.2
# Frames over which codec and activity are averaged, and rounding of float32, as a share.
_SLOW, _ROUNDING = 16, 3e-7


class FitSettings(Protocol):
    """The settings that a fit needs."""

    @property
    def registration(self) -> bool:
        """Whether the motion of the camera is followed."""

    @property
    def noise_floor(self) -> float:
        """Least noise of a pixel [grey steps]."""

    @property
    def codec_floor(self) -> float:
        """Least noise of a pixel in compressed video [grey steps]."""


@dataclass(frozen=True)
class FrameFit:
    """
    A frame in terms of the background.

    ``position`` is the place of the image in the planes, ``change`` what changed as a whole,
    ``floor`` the least noise of a pixel; ``local`` is a first estimate of the variance of the
    surroundings; ``codec`` and ``moved`` go into the state; with ``cut`` it is another scene.
    ``ratio`` is what is left in units of the expected noise ``spread``, at every few pixels;
    ``spectrum`` that of the frame, if it was needed.
    """

    position: tuple[float, float]
    change: Change
    floor: float
    local: np.ndarray
    codec: float
    moved: int
    cut: bool
    ratio: np.ndarray
    spread: np.ndarray
    spectrum: np.ndarray | None


def without_content(state: ConditionerState, frame: np.ndarray, values: np.ndarray) -> str:
    """Return why a frame cannot be used: ``blank``, ``saturated`` or ``flat``; or nothing."""
    step = frame_change.sample_step(state.shape)
    raw = frame[::step, ::step]
    sample = values[::step, ::step]
    known = abs(sample) < UNOBSERVED
    if known.mean() < 0.5:
        return 'blank'
    if np.issubdtype(frame.dtype, np.integer) and np.mean(raw == np.iinfo(frame.dtype).max) > 0.5:
        return 'saturated'
    if state.planes is None or state.frames < _YOUNG:
        return ''
    usual = np.hypot(_spread(state.planes.level[::step, ::step]),
                     3.3 * math.sqrt(float(np.median(some(state.local)))))
    least = 3.0 * np.issubdtype(frame.dtype, np.integer)
    return 'flat' if usual > least and _spread(sample[known]) < _FLAT * usual else ''


def _spread(values: np.ndarray) -> float:
    """Return the distance of the 5 % and the 95 % quantile."""
    few, tail = some(values), len(some(values)) // 20
    ranked = np.partition(few, (tail, -1 - tail))
    return float(ranked[-1 - tail] - ranked[tail])


def fit_frame(
    settings: FitSettings, state: ConditionerState, values: np.ndarray, integer: bool,
) -> FrameFit:
    """Return the best description of a frame by the background of the state."""
    assert state.planes is not None
    sample, still, local, floor = _first_look(settings, state, values, integer)
    unusual, best, known = _is_unusual(state, sample, still), still, None
    if settings.registration and (unusual or state.moved < _STILL_AFTER):
        known = spectrum(values)
        best = _registered(state, known, sample, still)
    if unusual and _is_unusual(state, sample, best):
        best = _scaled(sample, state.planes, best)
    codec, moved = state.codec, state.moved + 1 if best.position == state.position else 0
    if integer:
        codec += (looks_coded(state, values, best.position, sample.step) - codec) / min(
            state.frames, _SLOW)
        floor = max(settings.codec_floor if codec > CODED else settings.noise_floor, floor)
    if state.frames == 1:
        sample, local = _with_first_noise(state, sample, best.residual, floor)
    spread = np.hypot(sample.deviation(best.position), _own_noise(state, sample))
    wide = None if state.frames < 2 else frame_change.wide_change(
        best.residual, spread, sample.step, state.shape)
    rest = best.residual - (0.0 if wide is None else wide[::sample.step, ::sample.step])
    square = frame_change.mean_square(rest / spread)
    cut = _is_cut(sample, best, square) or _is_stale(
        state, sample, frame_change.mean_square(best.residual / spread))
    return FrameFit(
        best.position, Change(best.gain, best.offset, wide=wide), floor, local, codec,
        moved, cut, rest / spread, spread, known)


def _is_unusual(state: ConditionerState, sample: Sample, fit: Fit) -> bool:
    """Return whether more is left of a frame than usual, or too little is known of the scene."""
    square = frame_change.mean_square(fit.residual / sample.deviation(fit.position))
    return square > _UNUSUAL * state.activity + 0.02 or state.frames < _YOUNG


def with_noise(state: ConditionerState, fit: FrameFit, change: Change) -> tuple[Change, float]:
    """Return the change with that of the noise, and the activity after the frame."""
    step = frame_change.sample_step(state.shape)
    stripes = change.rows[::step, None] + change.cols[::step]
    ratio = fit.ratio - stripes / fit.spread if stripes.any() else fit.ratio
    square = frame_change.mean_square(ratio)
    growth = 1.0 if state.frames < _YOUNG else frame_change.noise_growth(ratio, state.activity)
    share = 1.0 / min(max(state.frames - 1, 1), _SLOW)
    activity = state.activity + share * (square / growth - state.activity)
    return replace(change, variance=growth), activity


def _first_look(
    settings: FitSettings, state: ConditionerState, values: np.ndarray, integer: bool,
) -> tuple[Sample, Fit, np.ndarray, float]:
    """Return a sample of the frame, its fit where it was, first noise, and least noise."""
    assert state.planes is not None
    step = frame_change.sample_step(state.shape)
    seen = values[::step, ::step]
    seen = np.where(abs(seen) < UNOBSERVED, seen, np.float32(np.nan))
    floor = _ROUNDING * float(np.nanmedian(abs(seen))) + 1e-12
    if integer:
        floor = max(settings.codec_floor if state.codec > CODED else settings.noise_floor, floor)
    count = min(state.frames, _SLOW)
    rows, cols = (
        np.clip((np.arange(size) * step + round(place)) // BLOCK, 0, blocks - 1)
        for size, place, blocks in zip(seen.shape, state.position, state.local.shape))
    noise = np.sqrt(np.maximum(state.local[np.ix_(rows, cols)], floor**2))
    sample = Sample(seen, step, noise.astype(np.float32), count)
    still = fit_level(sample, state.planes, state.position)
    local = state.local
    if state.frames == 1:
        sample, local = _with_first_noise(state, sample, still.residual, floor)
        still = fit_level(sample, state.planes, state.position)
    return sample, still, local, floor


def _own_noise(state: ConditionerState, sample: Sample) -> np.ndarray:
    """Return by how much the noise that pixels have shown exceeds that of their surroundings."""
    assert state.planes is not None
    own = own_variance(state.planes, np.ix_(*(
        np.clip(np.arange(size) * sample.step + round(place), 0, most - 1)
        for size, place, most in zip(sample.values.shape, state.position, state.shape))))
    return np.sqrt(np.maximum(own - sample.noise**2, 0.0))  # type: ignore[no-any-return]


def _with_first_noise(
    state: ConditionerState, sample: Sample, residual: np.ndarray, floor: float,
) -> tuple[Sample, np.ndarray]:
    """Return the sample with a first estimate of the noise, from the difference of two frames."""
    spread = max(float(np.nanmedian(abs(residual))) / 0.6745 / 2**0.5, floor)
    return (sample._replace(noise=np.full_like(sample.values, spread)),
            np.full_like(state.local, spread**2))


def _registered(
    state: ConditionerState, now: np.ndarray, sample: Sample, still: Fit,
) -> Fit:
    """Return the fit at another position if it is better by far; ``now`` is the spectrum."""
    assert state.planes is not None
    planes = state.planes
    past = spectrum(state.previous) if state.spectrum is None else state.spectrum
    down, right, response = phase_correlation(now, past, state.shape)
    there = (state.position[0] + down, state.position[1] + right)
    starts = [still]
    if response > _RESPONSE or max(abs(down), abs(right)) <= _NEAR_PX:
        starts.append(fit_level(sample, planes, there))
    start = min(starts, key=lambda fit: fit.energy)
    best = refine(sample, planes, start, moves=True, scales=False)
    return best if is_better(sample, best, still) else still


def _scaled(sample: Sample, planes: Planes, fit: Fit) -> Fit:
    """Return the fit with another gain if it is better by far."""
    contrast = float(np.nanstd(fit.background[0]))
    if contrast < _CONTRAST * float(np.median(sample.noise)):
        return fit
    scaled = refine(sample, planes, fit, moves=False, scales=True)
    accepted = scaled.energy < _FALL * fit.energy and abs(scaled.gain - 1.0) > _LEAST_GAIN
    return scaled if accepted and scaled.gain > 0.0 else fit


def _is_cut(sample: Sample, fit: Fit, square: float) -> bool:
    """Return whether the frame shows another scene."""
    known = np.isfinite(fit.residual)
    if square < _CUT_ENERGY or np.count_nonzero(known) < 16:
        return False
    values = sample.values[known]
    level = (values - fit.residual[known] - fit.offset) / fit.gain
    contrast, other = (float(plane.std(dtype=float)) for plane in (level, values))
    if min(contrast, other) < _CONTRAST * float(np.median(sample.noise)):
        return False
    return bool(np.corrcoef(values, level)[0, 1] < _CUT_CORRELATION)


def _is_stale(state: ConditionerState, sample: Sample, square: float) -> bool:
    """Return whether the frame is like the one before and not like the background."""
    if state.frames < _YOUNG or square < _STALE_ENERGY:
        return False
    change = sample.values - state.previous[::sample.step, ::sample.step]
    change = (change - np.nanmedian(change)) / sample.noise
    return bool(frame_change.mean_square(change) < _STALE * square)
