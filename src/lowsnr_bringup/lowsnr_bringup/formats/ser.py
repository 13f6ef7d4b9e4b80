# SPDX-License-Identifier: Apache-2.0
"""SER films of planetary cameras: 8 to 16 bits, both byte orders, a stamp for every frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
import struct
from typing import Literal

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats.bounds import check_frame_size
from lowsnr_bringup.formats.frames import FrameSource
from lowsnr_bringup.formats.frames import Pixels
from lowsnr_bringup.formats.frames import TimedFrame
import numpy as np
from numpy.typing import NDArray

SUFFIXES = ('.ser',)
_MAGIC, _HEADER = b'LUCAM-RECORDER', struct.Struct('<14s7i120s2q')
_Order = Literal['<', '>']
_MONO, _RGB, _BGR = 0, 100, 101
_BAYER = {8: 'RGGB', 9: 'GRBG', 10: 'GBRG', 11: 'BGGR'}
# Stamps count 100 ns since the year 1; those of 1970.
_TICK_NS, _UNIX_TICKS = 100, 621_355_968_000_000_000


@dataclass(frozen=True)
class _Film:
    """What the header declares, and where the stamps are."""

    color: int
    order: _Order  # as the header has it
    shape: tuple[int, ...]
    kind: np.dtype[np.unsignedinteger]
    count: int

    @property
    def frame_bytes(self) -> int:
        return int(np.prod(self.shape)) * self.kind.itemsize


def open_ser(path: Path, select: str | None = None) -> FrameSource:
    """
    Return the frames of a SER film.

    Note: writers disagree on what the byte-order flag of the header means, so the order in which
    neighbouring pixels differ less is taken, and the flag only where that does not tell.
    """
    try:
        with path.open('rb') as file:
            film = _film(path, file.read(_HEADER.size), path.stat().st_size)
            file.seek(_HEADER.size)
            kind = _ordered(film, file.read(film.frame_bytes))
            file.seek(_HEADER.size + film.count * film.frame_bytes)
            tail = file.read(8 * film.count)
            ticks = np.frombuffer(tail[:len(tail) // 8 * 8], '<i8')
    except OSError as error:
        raise UnusableFile(path, 'unreadable', f'cannot be read: {error.strerror}') from None
    source = FrameSource(path, lambda: iter(()), film.count)
    times_ns = _times_ns(ticks, film.count)
    if times_ns is not None:
        source.absolute, source.start_ns = True, int(times_ns[0])
    elif len(ticks):
        source.notes.append(
            'its stamps do not increase from each frame to the next and are not used')
    source.frames = lambda: _frames(path, film, kind, times_ns)
    return source


def _film(path: Path, head: bytes, size: int) -> _Film:
    """Return what the header declares; UnusableFile if the file does not hold it."""
    if len(head) < _HEADER.size or not head.startswith(_MAGIC):
        raise UnusableFile(path, 'unreadable', 'is not a SER film')
    _, _, color, little, cols, rows, bits, count, *_ = _HEADER.unpack(head)
    if color in _BAYER or color in (_MONO, _RGB, _BGR):
        channels = 3 if color in (_RGB, _BGR) else 1
    else:
        raise UnusableFile(path, 'not frames', f'its colours (number {color}) are not known')
    if not (cols > 0 and rows > 0 and 1 <= bits <= 16 and count > 0):
        raise UnusableFile(
            path, 'unreadable',
            f'declares {count} frames of {cols} x {rows} pixels of {bits} bits')
    check_frame_size(path, (rows, cols))
    film = _Film(
        color, '<' if little else '>', (rows, cols) if channels == 1 else (rows, cols, channels),
        np.dtype('u1' if bits <= 8 else 'u2'), count)
    if size < _HEADER.size + count * film.frame_bytes:
        raise UnusableFile(
            path, 'unreadable', f'declares {count} frames of {film.frame_bytes} bytes and has '
            f'{size} bytes')
    return film


def _ordered(film: _Film, data: bytes) -> np.dtype[np.unsignedinteger]:
    """Return the type of the pixels with the byte order in which neighbours differ less."""
    if film.kind.itemsize == 1:
        return film.kind
    orders: tuple[_Order, _Order] = ('<', '>')
    rough = {
        order: np.abs(np.diff(
            np.frombuffer(data, film.kind.newbyteorder(order)).astype(float).reshape(film.shape),
            axis=1)).mean() if film.shape[1] > 1 else 0.0 for order in orders}
    if max(rough.values()) <= 1.5 * min(rough.values()):
        return film.kind.newbyteorder(film.order)
    return film.kind.newbyteorder('<' if rough['<'] < rough['>'] else '>')


def _times_ns(ticks: NDArray[np.int64], count: int) -> NDArray[np.int64] | None:
    """Return the times of the frames [ns since 1970]; None where not all increase."""
    if len(ticks) < count or ticks[0] < _UNIX_TICKS or not (np.diff(ticks) > 0).all():
        return None
    if int(ticks[-1]) - _UNIX_TICKS > 2**63 // _TICK_NS - 1:
        return None
    return np.asarray((ticks - _UNIX_TICKS) * _TICK_NS)


def _frames(
    path: Path, film: _Film, kind: np.dtype[np.unsignedinteger],
    times_ns: NDArray[np.int64] | None,
) -> Iterator[TimedFrame]:
    with path.open('rb') as file:
        file.seek(_HEADER.size)
        for k in range(film.count):
            data = file.read(film.frame_bytes)
            pixels = np.frombuffer(data, kind).reshape(film.shape)
            yield TimedFrame(
                _grey(pixels, film.color), None if times_ns is None else int(times_ns[k]))


def _grey(pixels: Pixels, color: int) -> Pixels:
    """Return a frame with its colours as red, green and blue, or the luminance of a mosaic."""
    if color == _BGR:
        return pixels[..., ::-1]
    if color in _BAYER:
        import cv2
        native = np.ascontiguousarray(pixels.astype(pixels.dtype.newbyteorder('=')))
        return np.asarray(cv2.cvtColor(native, getattr(cv2, f'COLOR_Bayer{_BAYER[color]}2GRAY')))
    return pixels
