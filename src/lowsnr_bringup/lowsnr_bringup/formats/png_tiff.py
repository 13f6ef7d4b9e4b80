"""PNG and TIFF images, whose size is known before their pixels are unpacked."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import struct

from lowsnr_bringup.bags.compression import MAX_BYTES
from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats.bounds import check_frame_size
from lowsnr_common.settings.text import one_line
import numpy as np
from numpy.typing import NDArray

_PNG = b'\x89PNG\r\n\x1a\n'
_TIFF = {b'II*\0': ('<', 'I', 'H', 'I'), b'MM\0*': ('>', 'I', 'H', 'I'),
         b'II+\0': ('<', 'Q', 'Q', 'Q'), b'MM\0+': ('>', 'Q', 'Q', 'Q')}
_WIDTH, _HEIGHT = 256, 257
# Formats of a value by the type of its field.
_VALUES = {1: 'B', 3: 'H', 4: 'I', 16: 'Q'}


def check_image(path: Path, data: memoryview) -> None:
    """
    Check the size that a PNG or TIFF image declares.

    Raises
    ------
    UnusableFile
        With reason ``too large``, or ``unreadable`` if it is neither PNG nor TIFF.

    """
    try:
        if bytes(data[:8]) == _PNG:
            shape = struct.unpack_from('>II', data, 16)[::-1]
        else:
            fields = list(_tiff_fields(data))
            # Of a field that is there twice, the reader may take either.
            shape = tuple(max(value for tag, value in fields if tag == wanted)
                          for wanted in (_HEIGHT, _WIDTH))
    except (struct.error, LookupError, ValueError):
        raise UnusableFile(path, 'unreadable', 'is neither a PNG nor a TIFF image') from None
    check_frame_size(path, shape)


def _tiff_fields(data: memoryview) -> Iterator[tuple[int, int]]:
    """Yield tag and value of each field of the first image of a TIFF or BigTIFF file."""
    order, offset, count, size = _TIFF[bytes(data[:4])]
    start, = struct.unpack_from(order + offset, data, 8 if offset == 'Q' else 4)
    number, = struct.unpack_from(order + count, data, start)
    start += struct.calcsize(f'={count}')
    step = struct.calcsize(f'=HH{size}{size}')
    for entry in range(start, min(start + number * step, len(data)), step):
        tag, kind = struct.unpack_from(f'{order}HH', data, entry)
        if tag in (_WIDTH, _HEIGHT):
            place = entry + step - struct.calcsize(f'={size}')
            yield tag, struct.unpack_from(order + _VALUES[kind], data, place)[0]


def read_image(path: Path) -> NDArray[np.integer | np.floating]:
    """Return the pixels of an image, colours in OpenCV's order; raises :func:`check_image`'s."""
    import cv2
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise UnusableFile(
                path, 'too large', f'an image of {size} bytes, at most {MAX_BYTES} are read')
        data = path.read_bytes() if size else b''
        check_image(path, memoryview(data))
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except (OSError, cv2.error) as error:
        raise UnusableFile(path, 'unreadable', f'not an image: {one_line(error)}') from None
    if image is None:
        raise UnusableFile(path, 'unreadable', 'not an image')
    return np.asarray(image)
