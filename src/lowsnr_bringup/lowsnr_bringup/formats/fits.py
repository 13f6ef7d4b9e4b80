# SPDX-License-Identifier: Apache-2.0
"""
Frames of FITS files: images, extensions, cubes and compressed images, with their times.

The frames are all images of one shape and type, without those that extensions such as MASK or ERR
hold beside them.  Scaled numbers are scaled; blank pixels become NaN.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
import gzip
from pathlib import Path
import shutil
from tempfile import TemporaryDirectory
from typing import Any
import warnings
import zlib

from lowsnr_bringup.bags.errors import UNREADABLE
from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats.bounds import check_frame_size
from lowsnr_bringup.formats.fits_dates import seconds_of_a_plane
from lowsnr_bringup.formats.fits_dates import time_of
from lowsnr_bringup.formats.fits_tiles import unpacked_plane
from lowsnr_bringup.formats.frames import FrameSource
from lowsnr_bringup.formats.frames import library
from lowsnr_bringup.formats.frames import Pixels
from lowsnr_bringup.formats.frames import TimedFrame
from lowsnr_common.settings.text import one_line
import numpy as np

SUFFIXES = ('.fits', '.fit', '.fts', '.fz', '.fits.gz', '.fit.gz', '.fts.gz')
_MAGIC, _GZIP = b'SIMPLE', b'\x1f\x8b'
# A compressed file unpacks to at most so much, and leaves room for others on the disk.
_MOST_BYTES, _RESERVED_BYTES, _BLOCK_BYTES = 2**34, 2**26, 2**20
# What extensions beside the frames are named after, and names that say that they are the frames.
_BESIDE = ('MASK', 'DQ', 'BPM', 'BADPIX', 'ERR', 'UNCERT', 'STD', 'SIGMA', 'RMS', 'NOISE', 'VAR',
           'IVAR', 'WHT', 'WEIGHT', 'FLAG', 'QUAL', 'CTX', 'CONTEXT', 'EXPMAP', 'SKY', 'BKG',
           'BACKGROUND', 'PSF', 'AREA', 'MODEL', 'THUMB', 'PREVIEW')
_SCIENCE = ('SCI', 'SCIENCE')
_COLOURS = 3


@dataclass(frozen=True)
class _Unit:
    """An image in a FITS file."""

    index: int
    name: str
    shape: tuple[int, ...]  # without axes of length 1 before the last two
    kind: tuple[Any, ...]  # BITPIX, BZERO, BSCALE
    packed: bool
    time_ns: int | None
    plane_s: float | None  # time between planes

    @property
    def planes(self) -> int:
        return self.shape[0] if len(self.shape) == 3 else 1

    def __str__(self) -> str:
        return f'{self.name} ({" x ".join(map(str, self.shape[::-1]))}, BITPIX {self.kind[0]})'


def open_fits(path: Path, select: str | None = None) -> FrameSource:
    """Return the frames of a FITS file; ``select`` names an extension, or is its number."""
    with _opened(path) as (file, _):
        units = _chosen(path, _units(path, file), select)
    timed = all(_planes_have_times(unit) for unit in units) and len(
        {unit.time_ns for unit in units}) == len(units)
    source = FrameSource(
        path, lambda: _frames(path, units, timed), sum(unit.planes for unit in units),
        absolute=timed, start_ns=units[0].time_ns)
    if not timed and source.start_ns is not None and source.count != 1:
        source.notes.append(
            'its header has the time of the first frame only; --period states the time between '
            'frames')
    if any(unit.planes == _COLOURS and unit.plane_s is None for unit in units):
        source.notes.append('its 3 planes are taken as 3 frames, not as 3 colours')
    return source


def _planes_have_times(unit: _Unit) -> bool:
    return unit.time_ns is not None and (unit.planes == 1 or unit.plane_s is not None)


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Path]]:
    """Yield the units of a FITS file, and the file that holds them unpacked."""
    fits = library(path, 'astropy.io.fits', 'astropy')
    try:
        with TemporaryDirectory() as folder, warnings.catch_warnings(action='ignore'):
            plain = _plain(path, Path(folder))
            # Compressed images are unpacked by another process, see fits_tiles.
            with fits.open(plain, memmap=False, disable_image_compression=True) as units:
                yield units, plain
    except UnusableFile:
        raise
    except (*UNREADABLE, fits.VerifyError) as error:
        raise UnusableFile(path, 'unreadable', f'not a FITS image: {one_line(error)}') from None


def _plain(path: Path, folder: Path) -> Path:
    """Return the file itself, or what a gzip file holds."""
    with path.open('rb') as file:
        magic = file.read(len(_MAGIC))
    if magic == _MAGIC:
        return path
    if not magic.startswith(_GZIP):
        raise UnusableFile(path, 'unreadable', f'does not begin with {_MAGIC!r}')
    room = min(_MOST_BYTES, shutil.disk_usage(folder).free - _RESERVED_BYTES)
    plain = folder / 'plain.fits'
    try:
        with gzip.open(path) as packed, plain.open('wb') as file:
            while block := packed.read(_BLOCK_BYTES):
                if file.tell() == 0 and not block.startswith(_MAGIC):
                    raise UnusableFile(path, 'unreadable', f'holds no {_MAGIC!r}')
                if file.tell() + len(block) > room:
                    raise UnusableFile(
                        path, 'too large', f'unpacks to more than {room} bytes')
                file.write(block)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise UnusableFile(path, 'unreadable', f'is damaged: {one_line(error)}') from None
    return plain


def _units(path: Path, file: Any) -> list[_Unit]:
    """Return the images of a file."""
    found = []
    primary = file[0].header
    for index, unit in enumerate(file):
        header = unit.header
        packed = header.get('ZIMAGE') is True
        if header.get('XTENSION', 'IMAGE').strip() != 'IMAGE' and not packed:
            continue
        key = 'ZNAXIS' if packed else 'NAXIS'
        axes = [int(header[f'{key}{k}']) for k in range(int(header.get(key, 0)), 0, -1)]
        axes = [size for size in axes[:-2] if size != 1] + axes[-2:]
        if len(axes) < 2 or 0 in axes or header.get('GROUPS') is True:
            continue
        check_frame_size(path, tuple(axes[-2:]))
        name = str(header.get('EXTNAME') or ('PRIMARY' if index == 0 else '')).strip().upper()
        kind = (header.get('ZBITPIX' if packed else 'BITPIX'), header.get('BZERO', 0),
                header.get('BSCALE', 1))
        found.append(_Unit(
            index, name or f'number {index}', tuple(axes), kind, packed, time_of(header, primary),
            seconds_of_a_plane(header)))
    return found


def _chosen(path: Path, units: list[_Unit], select: str | None) -> list[_Unit]:
    """Return the images that are the frames."""
    held = ', '.join(map(str, units[:8])) + ', ...' * (len(units) > 8)
    if not units:
        raise UnusableFile(path, 'not frames', 'holds no image')
    if select is not None:
        chosen = [unit for unit in units if select.upper() in (unit.name, str(unit.index))]
        if not chosen:
            raise UnusableFile(path, 'no frames', f'has no image {select}; it holds {held}')
    else:
        chosen = [unit for unit in units if unit.name in _SCIENCE] or [
            unit for unit in units if not unit.name.startswith(_BESIDE)] or units
    if len({(unit.shape[-2:], unit.kind) for unit in chosen}) > 1:
        raise UnusableFile(
            path, 'several images', f'holds images of several kinds: {held}; --select NAME picks '
            'those of a name, or the one of a number')
    if any(len(unit.shape) > 3 for unit in chosen):
        raise UnusableFile(path, 'not frames', f'has an image of more than three axes: {held}')
    return chosen


def _frames(path: Path, units: list[_Unit], timed: bool) -> Iterator[TimedFrame]:
    with _opened(path) as (file, plain):
        for unit in units:
            for k in range(unit.planes):
                time_ns = unit.time_ns
                if time_ns is not None and k and unit.plane_s is not None:
                    time_ns += round(1e9 * k * unit.plane_s)
                pixels = (unpacked_plane(path, plain, unit.index, k) if unit.packed
                          else plane_of(file[unit.index], k))
                if pixels.shape != unit.shape[-2:]:
                    raise UnusableFile(
                        path, 'unreadable', f'{unit} has planes of shape {pixels.shape}')
                yield TimedFrame(pixels, time_ns if timed else None)


def plane_of(unit: Any, k: int) -> Pixels:
    """Return the kth plane (rows, cols) of an image, scaled, with NaN for blank pixels."""
    shape = unit.shape
    leading = [k if size > 1 else 0 for size in shape[:-2]]
    pixels = np.asarray(unit.section[(*leading, slice(None), slice(None))])
    blank = unit.header.get('BLANK', unit.header.get('ZBLANK'))
    if blank is None or pixels.dtype.kind == 'f' or int(unit.header.get('BITPIX', 8)) < 0:
        return pixels
    stored = int(blank) + int(unit.header.get('BZERO', 0))
    return np.where(pixels == stored, np.nan, pixels.astype(np.float64))
