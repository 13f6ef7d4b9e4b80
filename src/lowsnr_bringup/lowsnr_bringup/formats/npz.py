# SPDX-License-Identifier: Apache-2.0
"""Frames from ``.npy`` files and ``.npz`` archives, one frame in memory at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from dataclasses import replace
import math
from pathlib import Path
from typing import Any
from typing import IO
import zipfile

from lowsnr_bringup.bags.compression import MAX_BYTES
from lowsnr_bringup.bags.errors import UNREADABLE
from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats.bounds import check_frame_size
from lowsnr_bringup.formats.frames import FrameSource
from lowsnr_bringup.formats.frames import TimedFrame
from lowsnr_common.settings.text import one_line
import numpy as np
from numpy.typing import NDArray

MOST_FRAMES = 2**24  # whose times and truth are in memory: those of a day at 190 Hz
_MOST_NAMED = 8  # arrays in a line
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

    @property
    def can_be_frames(self) -> bool:
        """Whether it has the shape and type of frames, grey or in colours."""
        channels = self.shape[3:]
        return (len(self.shape) >= 3 and channels in ((), (1,), (3,), (4,))
                and 0 not in self.shape and self.dtype.kind in 'biuf')

    def __str__(self) -> str:
        return f'shape {self.shape} of {self.dtype}'


class FrameArchive:
    """
    An archive whose headers were checked.

    Parameters
    ----------
    path
        The file.
    select
        Name of the array with the frames; None for ``frames``, or the only array that can be.

    Attributes
    ----------
    count
        Number of frames.
    times_s : (T,) ndarray or None
        Times of the frames [s], increasing.
    truth : (T, 2) ndarray or None
        x (column), y (row) of the object [pixels], NaN where it is absent.
    unused
        Names of the arrays that are not read.

    Raises
    ------
    UnusableFile
        With reason ``unreadable``, ``no frames``, ``not frames``, ``too large``, ``bad t_s`` or
        ``bad truth``.

    """

    def __init__(self, path: Path, select: str | None = None) -> None:
        self._path = path
        names = self._names()
        self._name = self._chosen(names, select)
        self._frames = self._header(self._name)
        _check_frames(path, self._name, self._frames)
        self.count = self._frames.shape[0]
        self.truth = self._numbers('truth', (self.count, 2)) if 'truth' in names else None
        self.times_s = self._numbers('t_s', (self.count,)) if 't_s' in names else None
        self.unused = [name for name in names if name not in (self._name, 't_s', 'truth')]
        if self.times_s is not None and not (
                np.isfinite(self.times_s).all() and (np.diff(self.times_s) > 0.0).all()):
            raise UnusableFile(
                path, 'bad t_s', 't_s does not increase from each frame to the next')

    def __iter__(self) -> Iterator[NDArray[Any]]:
        try:
            with zipfile.ZipFile(self._path) as archive, archive.open(
                    f'{self._name}.npy') as file:
                yield from _frames_of(file, self._frames)
        except UNREADABLE as error:
            raise self._unreadable(error) from None

    def _names(self) -> list[str]:
        """Return the names of the arrays."""
        try:
            with zipfile.ZipFile(self._path) as archive:
                return [name.removesuffix('.npy') for name in archive.namelist()
                        if name.endswith('.npy')]
        except UNREADABLE as error:
            raise self._unreadable(error) from None

    def _chosen(self, names: list[str], select: str | None) -> str:
        """Return the name of the array with the frames."""
        wanted = select or 'frames'
        if wanted in names:
            return wanted
        headers = {}
        for name in names:
            with suppress(UnusableFile):  # it matters only if it is chosen
                headers[name] = self._header(name)
        cubes = [name for name, header in headers.items() if header.can_be_frames]
        if select is None and len(cubes) == 1:
            return cubes[0]
        named = [f'{name} {header}' for name, header in headers.items()]
        held = ', '.join(named[:_MOST_NAMED]) + ', ...' * (len(named) > _MOST_NAMED)
        raise UnusableFile(
            self._path, 'no frames', f'has no array {wanted}; it holds {held or "no array"}'
            + '; --select NAME picks one' * bool(headers))

    def _header(self, name: str) -> _Array:
        """Return the header of an array, which must have as many bytes as it declares."""
        try:
            with zipfile.ZipFile(self._path) as archive:
                member = archive.getinfo(f'{name}.npy')
                if member.compress_type not in _COMPRESSIONS:
                    raise ValueError(f'{name} is compressed by another method than deflate')
                with archive.open(member) as file:
                    header = _read_header(file)
                    held = member.file_size - file.tell()
        except UNREADABLE as error:
            raise self._unreadable(error) from None
        _check_size(self._path, name, header, held)
        return header

    def _numbers(self, name: str, shape: tuple[int, ...]) -> NDArray[np.floating]:
        """Return an array, which must have this shape."""
        header = self._header(name)
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


def open_npz(path: Path, select: str | None = None) -> FrameSource:
    """Return the frames, times and truth of an ``.npz`` archive."""
    archive = FrameArchive(path, select)
    times_s = archive.times_s
    times_ns = [None] * archive.count if times_s is None else [
        round(1e9 * float(each)) for each in times_s]
    source = FrameSource(
        path, lambda: map(TimedFrame, archive, times_ns), archive.count, truth=archive.truth)
    if times_s is not None and len(times_s) > 1:
        source.period_s = float(np.median(np.diff(times_s)))
    if archive.unused:
        source.notes.append(f'not used: {", ".join(archive.unused)}')
    return source


def open_npy(path: Path, select: str | None = None) -> FrameSource:
    """Return the frames of an ``.npy`` file, or the one, grey or in colours, that it is."""
    try:
        with path.open('rb') as file:
            header = _read_header(file)
            held = path.stat().st_size - file.tell()
    except UNREADABLE as error:
        raise UnusableFile(path, 'unreadable', f'cannot be read: {one_line(error)}') from None
    _check_size(path, 'the array', header, held)
    if len(header.shape) == 2 or (len(header.shape) == 3 and header.shape[-1] in (3, 4)):
        header = replace(header, shape=(1, *header.shape), columns_first=False)
    _check_frames(path, 'the array', header)
    return FrameSource(path, lambda: map(TimedFrame, _npy_frames(path, header)), header.shape[0])


def _npy_frames(path: Path, header: _Array) -> Iterator[NDArray[Any]]:
    try:
        with path.open('rb') as file:
            yield from _frames_of(file, header)
    except UNREADABLE as error:
        raise UnusableFile(path, 'unreadable', f'cannot be read: {one_line(error)}') from None


def _check_size(path: Path, name: str, header: _Array, held: int) -> None:
    if header.dtype.kind in 'biuf' and held != header.size:
        raise UnusableFile(
            path, 'unreadable',
            f'{name} declares {header}, {header.size} bytes, and has {held}')


def _check_frames(path: Path, name: str, header: _Array) -> None:
    """Check that an array can be read as frames."""
    if not header.can_be_frames:
        raise UnusableFile(
            path, 'not frames',
            f'{name} has {header}, must be (frames, rows, cols) of numbers, with a fourth axis of '
            '3 or 4 for colours')
    check_frame_size(path, header.shape[1:3])
    if header.columns_first and header.size > MAX_BYTES:
        raise UnusableFile(
            path, 'too large', f'{name} is in Fortran order and has {header.size} '
            f'bytes, at most {MAX_BYTES} are read at once; save it in C order')


def _frames_of(file: IO[bytes], header: _Array) -> Iterator[NDArray[Any]]:
    """Yield the frames of an array one after the other."""
    if header.columns_first:
        yield from np.lib.format.read_array(file, allow_pickle=False)
        return
    stored = _read_header(file)
    shape = header.shape[1:]
    if stored.columns_first:  # of an array of two dimensions, which is one frame
        yield np.frombuffer(file.read(stored.size), stored.dtype).reshape(shape[::-1]).T
        return
    size = math.prod(shape) * header.dtype.itemsize
    for _ in range(header.shape[0]):
        yield np.frombuffer(file.read(size), header.dtype).reshape(shape)
