# SPDX-License-Identifier: Apache-2.0
"""Images of any camera to arrays and back: one channel, whatever encoding, byte order and step."""

from __future__ import annotations

import array
from dataclasses import dataclass
import sys

from lowsnr_common.core.records import Malformed
from lowsnr_common.images.compressed import decode_compressed
from lowsnr_common.images.image_encodings import is_whole
from lowsnr_common.images.image_encodings import LARGEST
from lowsnr_common.images.image_encodings import pixels_of
import numpy as np
from sensor_msgs.msg import CompressedImage
from sensor_msgs.msg import Image
from std_msgs.msg import Header

_ENCODINGS = {'uint8': 'mono8', 'uint16': 'mono16', 'float32': '32FC1'}


@dataclass(frozen=True)
class LocalFrame:
    """A frame within a process instead of an image: header and cells, (rows, cols) float32."""

    header: Header
    cells: np.ndarray


def image_to_array(image: Image) -> np.ndarray:
    """
    Return an image as it is, NaN where a value is not finite or beyond 1e9.

    Returns
    -------
    (rows, cols) ndarray of uint8, uint16 or float32
        Pixels, the luminance of colours; a view of the message's data where that is possible.

    Raises
    ------
    Malformed
        If encoding, step or size do not fit; says which.

    """
    frame = pixels_of(image)
    return frame if is_whole(frame) else np.where(abs(frame) <= LARGEST, frame, np.float32('nan'))


def image_to_whole_array(image: Image | LocalFrame) -> np.ndarray:
    """
    Return what :func:`image_to_array` does of an image in which every pixel has a value.

    Raises
    ------
    Malformed
        If encoding, step or size do not fit, or a value is not finite or beyond 1e9; says which.

    """
    frame = image.cells if isinstance(image, LocalFrame) else pixels_of(image)
    if not is_whole(frame):
        row, col = np.argwhere(~(np.abs(frame) <= LARGEST))[0]
        said = 'beyond 1e9' if np.isfinite(frame[row, col]) else 'not a finite number'
        raise Malformed(f'cell {said}', f'cell at row {row}, column {col} is {said}')
    return frame


def array_to_image(frame: np.ndarray, header: Header) -> Image:
    """
    Return a frame (rows, cols) as an image of its own depth; any floating point as 32 bits.

    Raises
    ------
    ValueError
        If it is of another type than uint8, uint16 or floating point.

    """
    stored = frame.astype(np.float32) if frame.dtype.kind == 'f' else frame
    encoding = _ENCODINGS.get(stored.dtype.name)
    if encoding is None:
        raise ValueError(f'frames of {frame.dtype.name} cannot be stored; use uint8, uint16 '
                         'or floating-point numbers')
    data = array.array('B')
    data.frombytes(np.ascontiguousarray(stored).tobytes())
    return Image(
        header=header, height=stored.shape[0], width=stored.shape[1], encoding=encoding,
        is_bigendian=int(sys.byteorder == 'big'), step=stored.itemsize * stored.shape[1],
        data=data)


def unpacked(image: CompressedImage) -> Image:
    """Return a compressed image as one that nodes take; Malformed if it cannot be decoded."""
    return array_to_image(decode_compressed(image), image.header)
