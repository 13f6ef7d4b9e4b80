# SPDX-License-Identifier: Apache-2.0
"""
Frames from files: see :mod:`lowsnr_bringup.formats` for what is read.

Pixels stay as they are: 8 and 16 bits unsigned, anything else becomes 32-bit floating point.  A
colour image becomes its luminance, a blank pixel NaN.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from fnmatch import fnmatch
import os
from pathlib import Path

from lowsnr_bringup.bags.bag_files import by_number
from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats.film import FrameReader
from lowsnr_bringup.formats.fits import open_fits
from lowsnr_bringup.formats.fits import SUFFIXES as FITS
from lowsnr_bringup.formats.frames import FrameSource
from lowsnr_bringup.formats.frames import TimedFrame
from lowsnr_bringup.formats.images import open_image
from lowsnr_bringup.formats.npz import open_npy
from lowsnr_bringup.formats.npz import open_npz
from lowsnr_bringup.formats.pgm import open_pgm
from lowsnr_bringup.formats.pgm import SUFFIXES as PGM
from lowsnr_bringup.formats.pixels import Storing
from lowsnr_bringup.formats.ser import open_ser
from lowsnr_bringup.formats.ser import SUFFIXES as SER
from lowsnr_bringup.formats.tiff import open_tiff
from lowsnr_bringup.formats.tiff import SUFFIXES as TIFF
from lowsnr_bringup.formats.video import open_video
import numpy as np

Open = Callable[[Path, str | None], FrameSource]

# Formats of which a folder may hold one file a frame, each under one name for all its endings.
_OF_FOLDERS: dict[str, tuple[tuple[str, ...], Open]] = {
    'FITS': (FITS, open_fits), 'TIFF': (TIFF, open_tiff), 'PNG': (('.png',), open_image),
    'JPEG': (('.jpg', '.jpeg'), open_image), 'BMP': (('.bmp',), open_image),
    'PGM': (PGM, open_pgm), 'NumPy': (('.npy',), open_npy)}
_OTHERS: dict[str, tuple[tuple[str, ...], Open]] = {
    'NumPy archive': (('.npz',), open_npz), 'SER': (SER, open_ser)}
_VIDEOS = ('.mkv', '.avi', '.mp4', '.mov', '.m4v', '.mpg', '.mpeg', '.wmv', '.ts', '.webm',
           '.y4m', '.mj2', '.gif', '.3gp', '.mts', '.m2ts', '.flv', '.ogv', '.mxf', '.asf')
_FILMS = (*_VIDEOS, *(suffix for suffixes, _ in _OTHERS.values() for suffix in suffixes))
IMAGE_SUFFIXES = tuple(suffix for suffixes, _ in _OF_FOLDERS.values() for suffix in suffixes)


def open_frames(path: Path, select: str | None = None, pattern: str = '*') -> FrameReader:
    """
    Open a file with frames, or a folder of such files.

    Parameters
    ----------
    path
        The file or folder.
    select
        Array of an ``.npz``, or extension of FITS files, that holds the frames.
    pattern
        Names of the files of a folder that are read, such as ``*.png``.

    Raises
    ------
    UnusableFile
        With reason ``missing``, ``unreadable``, ``no reader``, ``no frames``, ``not frames`` (an
        array or image of another shape or type), ``several kinds``, ``several images``,
        ``too large``, ``not finite``, ``too fine`` or ``mixed`` (frames of several sizes or
        types); here for the first frame, while iterating for the others.

    """
    if not os.path.exists(path):  # unlike Path.exists it takes a name of any length
        raise UnusableFile(path, 'missing', 'there is no such file or folder')
    if not path.is_dir():
        return _reader(path, [_opener(path)(path, select)])
    files, opener = _files(path, pattern)
    if len(files) == 1:
        return _reader(files[0], [opener(files[0], select)])
    return _reader(path, _in_order(path, [opener(file, select) for file in files]))


def is_film(path: Path) -> bool:
    """Whether something has frames by its name, or by the names of what it holds."""
    endings = (*IMAGE_SUFFIXES, *_FILMS)
    try:
        names = [item.name for item in path.iterdir()] if path.is_dir() else [path.name]
    except OSError:
        return False
    return any(name.lower().endswith(endings) for name in names)


def _opener(path: Path) -> Open:
    """Return what opens a file, by its ending."""
    name = path.name.lower()
    for suffixes, opener in (*_OF_FOLDERS.values(), *_OTHERS.values()):
        if name.endswith(suffixes):
            return opener
    return open_video


def _files(path: Path, pattern: str) -> tuple[list[Path], Open]:
    """Return the files of a folder, which must be of one kind, and what opens them."""
    try:
        names = sorted(
            (item for item in path.iterdir() if fnmatch(item.name, pattern)), key=by_number)
    except OSError as error:
        raise UnusableFile(path, 'unreadable', f'cannot be read: {error.strerror}') from None
    kinds = {
        kind: (found, opener) for kind, (suffixes, opener) in _OF_FOLDERS.items()
        if (found := [item for item in names if item.name.lower().endswith(suffixes)])}
    if len(kinds) > 1:
        raise UnusableFile(
            path, 'several kinds', 'holds ' + ' and '.join(
                f'{len(found)} {kind}' for kind, (found, _) in kinds.items())
            + " files; --pattern '*.ENDING' picks those to read")
    if kinds:
        return next(iter(kinds.values()))
    films = [item for item in names if item.name.lower().endswith(_FILMS)]
    if len(films) == 1:
        return films, _opener(films[0])
    held = f'{len(films)} films or archives; name one' if films else (
        f'no image ({", ".join(IMAGE_SUFFIXES)})')
    raise UnusableFile(path, 'no frames', f'holds {held}')


def _in_order(path: Path, sources: list[FrameSource]) -> list[FrameSource]:
    """Return files in the order of their times if all have one, else in that of their names."""
    dated = [source.start_ns for source in sources if source.start_ns is not None]
    if len(dated) == len(sources):
        return [sources[k] for k in np.argsort(dated, kind='stable')]
    if dated:
        lacking = next(source.path for source in sources if source.start_ns is None)
        sources[0].notes.append(
            f'{len(sources) - len(dated)} of {len(sources)} files have no time ({lacking.name}); '
            'the files are taken in the order of their names')
    return sources


def _notes(sources: list[FrameSource]) -> Iterator[str]:
    """Yield what is to be said of the files, each sentence once."""
    files: dict[str, list[Path]] = {}
    for source in sources:
        for note in source.notes:
            files.setdefault(note, []).append(source.path)
    for note, paths in files.items():
        more = f' (and {len(paths) - 1} more files)' * (len(paths) > 1)
        yield f'{paths[0]}{more}: {note}'


def _reader(path: Path, sources: list[FrameSource]) -> FrameReader:
    """Return a reader of the frames of some files."""
    notes: list[str] = []
    single = len(sources) > 1 and all(source.count == 1 for source in sources)
    timed = all(source.absolute for source in sources) or len(sources) == 1
    storing = Storing(notes)

    def frames() -> Iterator[TimedFrame]:
        storing.begin()
        for source in sources:
            for frame in source.frames():
                where = '' if single or len(sources) == 1 == source.count else 'frame'
                yield TimedFrame(
                    storing.storable(frame.pixels, source.path, where),
                    frame.time_ns if timed else None)
        storing.end(path)
        notes.extend(note for note in _notes(sources) if note not in notes)

    first = next(frames(), None)
    if first is None:
        raise UnusableFile(path, 'no frames', 'holds no frame')
    counts = [source.count for source in sources]
    periods = {source.period_s for source in sources}
    return FrameReader(
        frames, (first.pixels.shape[0], first.pixels.shape[1]), first.pixels.dtype,
        sum(each for each in counts if each is not None) if None not in counts else None,
        period_s=periods.pop() if len(periods) == 1 else None,
        absolute=timed and sources[0].absolute,
        truth=sources[0].truth if len(sources) == 1 else None,
        files=tuple(source.path.name for source in sources) if single else (), notes=notes,
        path=path)
