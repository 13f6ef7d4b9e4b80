"""PNG, JPEG and BMP images, whose size is known before their pixels are unpacked."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import struct

from lowsnr_bringup.bags.compression import MAX_BYTES
from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats.bounds import check_frame_size
from lowsnr_bringup.formats.frames import FrameSource
from lowsnr_bringup.formats.frames import Pixels
from lowsnr_bringup.formats.frames import TimedFrame
from lowsnr_common.settings.text import one_line
import numpy as np

SUFFIXES = ('.png', '.jpg', '.jpeg', '.bmp')
_PNG, _JPEG, _BMP = b'\x89PNG\r\n\x1a\n', b'\xff\xd8\xff', b'BM'
# Markers of a JPEG image: frames that declare a size, and markers without a length.
_SIZED = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
_BARE = {0x01, 0xFF, *range(0xD0, 0xD9)}


def open_image(path: Path, select: str | None = None) -> FrameSource:
    """Return the one frame of an image file."""
    def frames() -> Iterator[TimedFrame]:
        yield TimedFrame(decode_image(path, read_bytes(path)))
    return FrameSource(path, frames, 1)


def read_bytes(path: Path) -> bytes:
    """Return the content of a file that is read at once; UnusableFile if it is too large."""
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise UnusableFile(
                path, 'too large', f'an image of {size} bytes, at most {MAX_BYTES} are read')
        return path.read_bytes()
    except OSError as error:
        raise UnusableFile(path, 'unreadable', f'not an image: {one_line(error)}') from None


def decode_image(path: Path, data: bytes) -> Pixels:
    """
    Return the pixels of a PNG, JPEG or BMP image at its depth, colours as red, green, blue.

    Raises
    ------
    UnusableFile
        With reason ``too large`` or ``unreadable``.

    """
    import cv2  # slow to import
    try:
        shape = _declared_shape(data)
    except (struct.error, LookupError, ValueError):
        raise UnusableFile(
            path, 'unreadable', 'is neither a PNG nor a JPEG nor a BMP image') from None
    check_frame_size(path, shape)
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise UnusableFile(path, 'unreadable', f'not an image: {one_line(error)}') from None
    finally:
        cv2.utils.logging.setLogLevel(level)
    if image is None:
        raise UnusableFile(path, 'unreadable', 'not an image')
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
