# SPDX-License-Identifier: Apache-2.0
"""
PNG, JPEG and BMP images in memory, whose size is known before their pixels are unpacked.

Those of ``sensor_msgs/CompressedImage`` are PNG or JPEG; other ways are refused by name.
"""

from __future__ import annotations

import struct
from typing import Any

from lowsnr_common.core.records import Malformed
from lowsnr_common.images.image_encodings import luminance
from lowsnr_common.settings.text import one_line
import numpy as np

MOST_PIXELS = 2**26  # 8192 x 8192: a small file can declare, or unpack to, gigabytes
_PNG, _JPEG, _BMP = b'\x89PNG\r\n\x1a\n', b'\xff\xd8\xff', b'BM'
# Markers of a JPEG image: frames that declare a size, and markers without a length.
_SIZED = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
_BARE = {0x01, 0xFF, *range(0xD0, 0xD9)}


def decode_compressed(message: Any) -> np.ndarray:
    """
    Return the pixels of a compressed image, a message with the fields ``format`` and ``data``.

    Returns
    -------
    (rows, cols) ndarray of uint8 or uint16
        Pixels, the luminance of colours.

    Raises
    ------
    Malformed
        If the format is not PNG or JPEG, or the data are not what it says.

    """
    how = message.format.lower()
    if 'compresseddepth' in how or not any(kind in how for kind in ('png', 'jpeg', 'jpg')):
        raise Malformed(
            'wrong encoding', f'format is {message.format[:40]!r}, must be png or jpeg')
    return luminance(decode_image(bytes(message.data)))


def decode_image(data: bytes) -> np.ndarray:
    """
    Return the pixels of a PNG, JPEG or BMP image at its depth, colours as red, green, blue.

    Raises
    ------
    Malformed
        With reason ``too large`` or ``unreadable``.

    """
    import cv2  # slow to import
    try:
        rows, cols = _declared_shape(data)
    except (struct.error, LookupError, ValueError):
        raise Malformed('unreadable', 'is neither a PNG nor a JPEG nor a BMP image') from None
    if rows * cols > MOST_PIXELS:
        raise Malformed(
            'too large', f'a frame of {cols} x {rows} pixels, at most {MOST_PIXELS} pixels are '
            'read')
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise Malformed('unreadable', f'not an image: {one_line(error)}') from None
    finally:
        cv2.utils.logging.setLogLevel(level)
    if image is None:
        raise Malformed('unreadable', 'not an image')
    pixels = np.asarray(image)
    return pixels if pixels.ndim == 2 else pixels[..., [2, 1, 0, 3][:pixels.shape[2]]]


def _declared_shape(data: bytes) -> tuple[int, int]:
    """Return rows and columns as the image declares them."""
    if data.startswith(_PNG):
        cols, rows = struct.unpack_from('>II', data, 16)
    elif data.startswith(_BMP):
        cols, rows = struct.unpack_from('<ii', data, 18)
    elif data.startswith(_JPEG):
        rows, cols = _jpeg_shape(data)
    else:
        raise ValueError
    return abs(rows), abs(cols)


def _jpeg_shape(data: bytes) -> tuple[int, int]:
    """Return the largest size that any frame of a JPEG image declares before its pixels."""
    shape, start = (0, 0), 2
    while True:
        mark, marker = struct.unpack_from('BB', data, start)
        if mark != 0xFF:
            raise ValueError
        if marker in _BARE:
            start += 1 if marker == 0xFF else 2
            continue
        length, = struct.unpack_from('>H', data, start + 2)
        if marker in _SIZED:
            rows, cols = struct.unpack_from('>HH', data, start + 5)
            shape = max(shape, (rows, cols), key=lambda size: size[0] * size[1])
        if marker == 0xDA:
            return shape
        start += 2 + length
