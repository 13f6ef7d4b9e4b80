# SPDX-License-Identifier: Apache-2.0
"""Arrays of frames, checked before anything is computed."""

from __future__ import annotations

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.images.image_encodings import is_whole
from lowsnr_common.images.image_encodings import LARGEST
from lowsnr_common.settings.text import did_you_mean
import numpy as np
import numpy.typing as npt

CHOICES = ('auto', 'on', 'off')
# Frames whose noise is taken for the wrong one: its standard deviation is off by this factor, or
# its mean by as many standard deviations.
_FAR = 2.0
# Pixels of each of so many frames that the noise is estimated from, and the deviation of normal
# noise over its median absolute deviation.
_PIXELS, _FRAMES, _NORMAL = 4096, 8, 1.4826


def as_frames(frames: npt.ArrayLike) -> np.ndarray:
    """
    Return frames as an array (K, rows, cols) of integers or floating-point numbers.

    It is a masked one if they are.

    Raises
    ------
    ValueError
        If they are none, in one line.

    """
    try:
        if isinstance(frames, (list, tuple)) and any(map(np.ma.isMaskedArray, frames)):
            frames = np.ma.stack(frames)
        array = frames if isinstance(frames, np.ma.MaskedArray) else np.asarray(frames)
    except ValueError:
        raise ValueError('frames: they differ in size, pass those of one size') from None
    if array.dtype.kind not in 'iuf':
        raise ValueError(
            f'frames: numbers of type {array.dtype}, must be integers or floating point')
    if array.ndim != 3 or 0 in array.shape:
        remedy = {2: ': pass frame[None] for a single one',
                  4: ': pass one channel, such as frames[..., 0]'}.get(array.ndim, '')
        raise ValueError(f'frames: shape {array.shape}, must be (frames, rows, cols){remedy}')
    return array


def unmasked(frames: np.ndarray) -> np.ndarray:
    """Return frames with NaN in place of masked pixels; with none they keep their type."""
    if not np.ma.is_masked(frames):
        return np.ma.getdata(frames)
    return np.asarray(np.ma.filled(np.ma.asarray(frames).astype(np.float32), np.nan))


def is_conditioned(frames: np.ndarray, condition: str) -> bool:
    """
    Return whether frames are to be conditioned: if asked for, or if they are integers.

    Raises
    ------
    ValueError
        If ``condition`` is none of its choices.

    """
    if condition not in CHOICES:
        raise ValueError(
            f'condition = {condition!r}, must be one of {", ".join(map(repr, CHOICES))}'
            + did_you_mean(str(condition), CHOICES))
    return condition == 'on' or (condition == 'auto' and frames.dtype.kind in 'iu')


def check_conditionable(frames: np.ndarray, warm_up_frames: int) -> None:
    """Raise ValueError if frames are too few for a conditioner to know their background."""
    count = len(frames)
    if count <= warm_up_frames:
        raise ValueError(
            f'frames: {count} frames, a conditioner needs more than {warm_up_frames}: pass more '
            "frames, or condition='off' for white noise of known deviation")


def check_white(frames: np.ndarray, sensor: SensorModel) -> None:
    """
    Check that frames are what a detector takes as they are: white noise, plus objects.

    Raises
    ------
    ValueError
        If a value is not finite or beyond 1e9, or Gaussian noise is clearly not what it should be.

    """
    for k, frame in enumerate(frames):
        if not is_whole(frame):
            row, col = np.argwhere(~(np.abs(frame.astype(float)) <= LARGEST))[0]
            raise ValueError(
                f'frames: frame {k}, row {row}, column {col} is {frame[row, col]}: set it to a '
                "finite number up to 1e9, or pass condition='on'")
    if sensor.noise.model != 'gaussian':
        return
    some, noise_std = _some(frames), sensor.noise_std
    mean = float(np.median(some))
    deviation = _NORMAL * float(np.median(np.abs(some - mean)))
    if not noise_std / _FAR <= deviation <= _FAR * noise_std or abs(mean) > _FAR * noise_std:
        raise ValueError(
            f'frames: their noise has the median {mean:.3g} and the standard deviation '
            f"{deviation:.3g}, must be 0 and {noise_std:g}: pass condition='on' for frames of a "
            f"camera, or settings={{'all.sensor.noise_std': {deviation:.3g}}} for white noise of "
            'another deviation')


def camera_pixels(frame: np.ndarray) -> np.ndarray:
    """
    Return a frame as a conditioner takes it, NaN where a value is not finite or beyond 1e9.

    Integers of up to 16 bits without sign stay what they are; all else becomes float32.
    """
    if frame.dtype.kind == 'u' and frame.dtype.itemsize <= 2:
        return frame
    with np.errstate(over='ignore'):
        values = frame.astype(np.float32)
    return np.where(abs(values) <= LARGEST, values, np.float32('nan'))


def detector_frame(frame: np.ndarray) -> np.ndarray:
    """Return a frame as a detector takes it: the numbers of a 32-bit image, as float64."""
    return frame.astype(np.float32).astype(float)


def _some(frames: np.ndarray) -> np.ndarray:
    """Return pixels from all over some of the frames."""
    chosen = frames[::max(1, len(frames) // _FRAMES)]
    return chosen.reshape(-1)[::max(1, chosen.size // (_PIXELS * _FRAMES))].astype(float)
