"""Frames with their times and truth from ``.npz`` archives, one frame in memory at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import math
from pathlib import Path
from typing import IO
import zipfile

from lowsnr_bringup.bags.compression import MAX_BYTES
from lowsnr_bringup.bags.errors import UNREADABLE
from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats.bounds import check_frame_size
from lowsnr_common.settings.text import one_line
import numpy as np
from numpy.typing import NDArray

# Times and truth are in memory for all frames: those of a day at 190 Hz.
MOST_FRAMES = 2**24
# Others unpack a few bytes to gigabytes at once.
_COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


@dataclass(frozen=True)
class _Array:
    """What the header of an array declares."""

    shape: tuple[int, ...]
    columns_first: bool
    dtype: np.dtype[np.generic]

    @property
    def size(self) -> int:
        """Return the number of bytes."""
        return math.prod(self.shape) * self.dtype.itemsize

    def __str__(self) -> str:
        return f'shape {self.shape} of {self.dtype}'


class FrameArchive:
    """
    An archive whose headers were checked.

    Attributes
    ----------
    count
        Number of frames.
    times_s : (T,) ndarray or None
        Times of the frames [s], increasing.
    truth : (T, 2) ndarray or None
        x (column), y (row) of the object [pixels], NaN where it is absent.

    Raises
    ------
    UnusableFile
        With reason ``unreadable``, ``no frames``, ``not frames``, ``too large``, ``bad t_s`` or
        ``bad truth``.

    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._frames = self._header('frames')
        shape = self._frames.shape
        if len(shape) != 3 or 0 in shape or self._frames.dtype.kind not in 'fiu':
            raise UnusableFile(
                path, 'not frames',
                f'frames has {self._frames}, must be (frames, rows, cols) of numbers')
        check_frame_size(path, shape[1:])
        if self._frames.columns_first and self._frames.size > MAX_BYTES:
            raise UnusableFile(
                path, 'too large', f'frames is in Fortran order and has {self._frames.size} '
                f'bytes, at most {MAX_BYTES} are read at once; save it in C order')
        self.count = shape[0]
        self.truth = self._numbers('truth', (self.count, 2))
        self.times_s = self._numbers('t_s', (self.count,))
        if self.times_s is not None and not (
                np.isfinite(self.times_s).all() and (np.diff(self.times_s) > 0.0).all()):
            raise UnusableFile(
                path, 'bad t_s', 't_s does not increase from each frame to the next')

    def __iter__(self) -> Iterator[NDArray[np.integer | np.floating]]:
        try:
            with zipfile.ZipFile(self._path) as archive, archive.open('frames.npy') as file:
                if self._frames.columns_first:
                    yield from np.lib.format.read_array(file, allow_pickle=False)
                    return
                _read_header(file)
                shape = self._frames.shape[1:]
                size = math.prod(shape) * self._frames.dtype.itemsize
                for _ in range(self.count):
                    data = file.read(size)
                    yield np.frombuffer(data, self._frames.dtype).reshape(shape)
        except UNREADABLE as error:
            raise self._unreadable(error) from None

    def _header(self, name: str) -> _Array:
        """Return the header of an array, which must have as many bytes as it declares."""
        try:
            with zipfile.ZipFile(self._path) as archive:
                if f'{name}.npy' not in archive.namelist():
                    raise UnusableFile(self._path, f'no {name}', f'has no array {name}')
                member = archive.getinfo(f'{name}.npy')
                if member.compress_type not in _COMPRESSIONS:
                    raise ValueError(f'{name} is compressed by another method than deflate')
                with archive.open(member) as file:
                    header = _read_header(file)
                    held = member.file_size - file.tell()
        except UnusableFile:
            raise
        except UNREADABLE as error:
            raise self._unreadable(error) from None
        if header.dtype.kind in 'fiu' and held != header.size:
            raise UnusableFile(
                self._path, 'unreadable',
                f'{name} declares {header}, {header.size} bytes, and has {held}')
        return header

    def _numbers(self, name: str, shape: tuple[int, ...]) -> NDArray[np.floating] | None:
        """Return an array of this shape, or None if there is none of this name."""
        try:
            header = self._header(name)
        except UnusableFile as error:
            if error.reason == f'no {name}':
                return None
            raise
        if header.shape != shape or header.dtype.kind not in 'fiu':
            raise UnusableFile(
                self._path, f'bad {name}', f'{name} has {header}, must be {shape} of numbers')
        if self.count > MOST_FRAMES:
            raise UnusableFile(
                self._path, 'too large',
                f'{name} is that of {self.count} frames, at most {MOST_FRAMES} are read')
        try:
            with zipfile.ZipFile(self._path) as archive, archive.open(f'{name}.npy') as file:
                return np.asarray(np.lib.format.read_array(file, allow_pickle=False), float)
        except UNREADABLE as error:
            raise self._unreadable(error) from None

    def _unreadable(self, error: BaseException) -> UnusableFile:
        return UnusableFile(self._path, 'unreadable', f'cannot be read: {one_line(error)}')


def _read_header(file: IO[bytes]) -> _Array:
    version = np.lib.format.read_magic(file)
    if version not in _HEADERS:
        raise ValueError(f'version {version} of the format of arrays is not known')
    return _Array(*_HEADERS[version](file))
