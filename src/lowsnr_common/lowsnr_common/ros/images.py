"""Images of any camera to arrays: one channel, whatever its depth, byte order and step."""

from __future__ import annotations

from lowsnr_common.core.records import Malformed
import numpy as np
from sensor_msgs.msg import Image

# Numbers beyond it are no intensities; squared and summed up they still are finite.
LARGEST = 1e9
_KINDS = {'mono8': 'u1', '8UC1': 'u1', 'mono16': 'u2', '16UC1': 'u2', '32FC1': 'f4'}


def image_to_array(image: Image) -> np.ndarray:
    """
    Return an image as it is, NaN where a value is not finite or beyond 1e9.

    Returns
    -------
    (rows, cols) ndarray of uint8, uint16 or float32
        Pixels; a view of the message's data unless some have no value.

    Raises
    ------
    Malformed
        If encoding, step or size do not fit; says which.

    """
    frame = _view(image)
    return frame if _is_whole(frame) else np.where(abs(frame) <= LARGEST, frame, np.float32('nan'))


def image_to_whole_array(image: Image) -> np.ndarray:
    """
    Return what :func:`image_to_array` does of an image in which every pixel has a value.

    Raises
    ------
    Malformed
        If encoding, step or size do not fit, or a value is not finite or beyond 1e9; says which.

    """
    frame = _view(image)
    if not _is_whole(frame):
        row, col = np.argwhere(~(np.abs(frame) <= LARGEST))[0]
        said = 'beyond 1e9' if np.isfinite(frame[row, col]) else 'not a finite number'
        raise Malformed(f'cell {said}', f'cell at row {row}, column {col} is {said}')
    return frame


def _is_whole(frame: np.ndarray) -> bool:
    """Return whether every pixel has a value: of a frame with NaN no comparison is true."""
    return frame.dtype.kind != 'f' or bool(frame.min() >= -LARGEST and frame.max() <= LARGEST)


def _view(image: Image) -> np.ndarray:
    """Return the pixels of an image as a view of its data; Malformed if its fields do not fit."""
    if image.encoding not in _KINDS:
        raise Malformed('wrong encoding', f'encoding is {image.encoding[:40]!r}, must be one of '
                        + ', '.join(_KINDS))
    rows, cols, step = image.height, image.width, image.step
    kind = np.dtype(_KINDS[image.encoding]).newbyteorder('>' if image.is_bigendian else '<')
    if rows == 0 or cols == 0:
        raise Malformed('empty frame', f'frame of {cols} x {rows} cells is empty')
    if step < kind.itemsize * cols:
        raise Malformed(
            'wrong step', f'step is {step} bytes, must be at least {kind.itemsize * cols}')
    if len(image.data) != rows * step:
        raise Malformed(
            'wrong size', f'data holds {len(image.data)} bytes, must be {rows * step}')
    return np.ndarray((rows, cols), kind, image.data, strides=(step, kind.itemsize))
