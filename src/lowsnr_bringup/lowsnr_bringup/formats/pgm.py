# SPDX-License-Identifier: Apache-2.0
"""PGM and PPM images (Netpbm), also several in one file, at the depth that they declare."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import re
from typing import NamedTuple

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats.bounds import check_frame_size
from lowsnr_bringup.formats.frames import FrameSource
from lowsnr_bringup.formats.frames import Pixels
from lowsnr_bringup.formats.frames import TimedFrame
from lowsnr_bringup.formats.images import read_bytes
import numpy as np

SUFFIXES = ('.pgm', '.ppm', '.pnm')
_CHANNELS = {b'P2': 1, b'P5': 1, b'P3': 3, b'P6': 3}
_PLAIN = {b'P2', b'P3'}
_GAP = rb'(?:\s|#[^\n]*\n)+'
_HEADER = re.compile(rb'\s*(P[2356])' + 3 * (_GAP + rb'(\d{1,9})') + rb'\s')


class _Image(NamedTuple):
    """An image in a file: its shape, its numbers, and where the next one starts."""

    shape: tuple[int, ...]
    numbers: Pixels
    end: int


def open_pgm(path: Path, select: str | None = None) -> FrameSource:
    """Return the frames of a file of one or more PGM or PPM images."""
    def frames() -> Iterator[TimedFrame]:
        data, start = read_bytes(path), 0
        while start == 0 or data[start:start + 256].strip():
            image = _read(path, data, start)
            yield TimedFrame(image.numbers.reshape(image.shape))
            start = image.end
    return FrameSource(path, frames)


def _read(path: Path, data: bytes, start: int) -> _Image:
    """Read the image that starts at a byte."""
    header = _HEADER.match(data, start)
    if header is None:
        raise UnusableFile(
            path, 'unreadable', f'byte {start}: not a PGM or PPM image (P2, P3, P5, P6)')
    cols, rows, largest = (int(header[k]) for k in (2, 3, 4))
    channels, plain = _CHANNELS[header[1]], header[1] in _PLAIN
    check_frame_size(path, (rows, cols))
    if not 0 < largest < 2**16:
        raise UnusableFile(path, 'unreadable', f'its largest value is {largest}, not 1 to 65535')
    size = rows * cols * channels
    kind = np.dtype('>u2' if largest > 255 else 'u1')
    held = data[header.end():] if plain else data[header.end():header.end() + size * kind.itemsize]
    try:
        values = (np.array(held.split()[:size], np.int64) if plain else np.frombuffer(held, kind))
        if not 0 <= int(values.min()) <= int(values.max()) <= largest:
            raise UnusableFile(
                path, 'unreadable', f'holds {values.min()} to {values.max()}, not 0 to {largest}')
        numbers = values.astype(kind)
        shape = (rows, cols) if channels == 1 else (rows, cols, channels)
        return _Image(
            shape, numbers.reshape(shape), len(data) if plain else header.end() + len(held))
    except (ValueError, OverflowError):
        raise UnusableFile(
            path, 'unreadable', f'does not hold the {size} values that it declares') from None
