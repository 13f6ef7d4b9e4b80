"""
Frames from files: ``.npz`` archives, folders of images, videos.

Pixels stay as they are: 8 and 16 bits unsigned, anything else becomes 32-bit floating point.  A
colour image becomes its luminance.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from dataclasses import dataclass
from dataclasses import field
import itertools
import os
from pathlib import Path

from lowsnr_bringup.bags.bag_files import by_number
from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats.bounds import check_frame_size
from lowsnr_bringup.formats.fits import read_fits
from lowsnr_bringup.formats.npz import FrameArchive
from lowsnr_bringup.formats.png_tiff import read_image
import numpy as np
from numpy.typing import NDArray

Frame = NDArray[np.integer | np.floating]

IMAGE_SUFFIXES = ('.png', '.tif', '.tiff', '.fits', '.fit', '.fts')
_FITS = ('.fits', '.fit', '.fts')
_GREY = 'colour frames are converted to grey'


@dataclass
class FrameReader:
    """
    Frames of one size and type, read one after the other: each iteration reads them anew.

    It raises :class:`~lowsnr_bringup.bags.errors.UnusableFile` where a frame cannot be read.

    Attributes
    ----------
    frames
        Returns the frames from the first on.
    shape
        Rows and columns of every frame.
    dtype
        Type of every frame: ``uint8``, ``uint16`` or ``float32``.
    count : int or None
        Number of frames; None if it is not known before they are read.
    times_s : (T,) ndarray or None
        Times of the frames [s], increasing; None if unknown.
    period_s : float or None
        Time between frames [s] of a video that states it.
    truth : (T, 2) ndarray or None
        x (column), y (row) of the object [pixels], NaN where it is absent; None if unknown.
    notes : list of str
        What a user should know, complete once all frames are read.

    """

    frames: Callable[[], Iterator[Frame]]
    shape: tuple[int, int]
    dtype: np.dtype[np.integer | np.floating]
    count: int | None = None
    times_s: NDArray[np.floating] | None = None
    period_s: float | None = None
    truth: NDArray[np.floating] | None = None
    notes: list[str] = field(default_factory=list)

    def __iter__(self) -> Iterator[Frame]:
        return self.frames()

    def even_period_s(self, period_s: float | None = None) -> float | None:
        """
        Return the time between frames [s] where it is the same throughout, else None.

        ``period_s`` replaces the period and the times of the files.  The period is 1 s where
        neither states one.
        """
        if period_s is None and self.times_s is not None and len(self.times_s) > 1:
            return None
        return period_s or self.period_s or 1.0

    def stamps_ns(self, period_s: float | None = None) -> Iterator[int]:
        """
        Return the stamps of the frames [ns].

        The first one is a period, never 0; see :meth:`even_period_s` for ``period_s``.
        """
        even_s = self.even_period_s(period_s)
        if self.times_s is None or even_s is not None:
            return (round(k * (even_s or 1.0) * 1e9) for k in itertools.count(1))
        first_s = np.median(np.diff(self.times_s)) - self.times_s[0]
        return (round((first_s + t) * 1e9) for t in self.times_s)


def open_frames(path: Path) -> FrameReader:
    """
    Open an ``.npz`` archive, a folder of images or a video.

    Raises
    ------
    UnusableFile
        With reason ``missing``, ``unreadable``, ``no frames``, ``not frames`` (an array or image
        of another shape or type), ``too large``, ``not finite`` or ``mixed`` (frames of several
        sizes or types); here for the first frame, while iterating for the others.

    """
    if not os.path.exists(path):  # unlike Path.exists it takes a name of any length
        raise UnusableFile(path, 'missing', 'there is no such file or folder')
    if path.is_dir():
        return _folder(path)
    return _archive(path) if path.suffix == '.npz' else _video(path)


def _archive(path: Path) -> FrameReader:
    archive = FrameArchive(path)
    reader = _reader(path, lambda: iter(archive), [], [])
    reader.count, reader.times_s, reader.truth = archive.count, archive.times_s, archive.truth
    return reader


def _folder(path: Path) -> FrameReader:
    try:
        files = sorted(
            (item for item in path.iterdir() if item.suffix.lower() in IMAGE_SUFFIXES),
            key=by_number)
    except OSError as error:
        raise UnusableFile(path, 'unreadable', f'cannot be read: {error.strerror}') from None
    if not files:
        raise UnusableFile(path, 'no frames', f'holds no image ({", ".join(IMAGE_SUFFIXES)})')
    notes: list[str] = []
    reader = _reader(path, lambda: (_image(item, notes) for item in files), files, notes)
    reader.count = len(files)
    return reader


def _image(path: Path, notes: list[str]) -> Frame:
    if path.suffix.lower() in _FITS:
        return np.asarray(read_fits(path))
    return _grey(read_image(path), notes)


def _grey(image: Frame, notes: list[str]) -> Frame:
    """Return one channel of an image in OpenCV's order: blue, green, red and perhaps alpha."""
    if image.ndim == 2:
        return image
    if (image[..., :3] == image[..., :1]).all():
        return image[..., 0]
    import cv2
    if _GREY not in notes:
        notes.append(_GREY)
    return np.asarray(cv2.cvtColor(image[..., :3], cv2.COLOR_BGR2GRAY))


def _video(path: Path) -> FrameReader:
    import cv2
    notes: list[str] = []

    def opened() -> cv2.VideoCapture:
        level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        video = cv2.VideoCapture(str(path))
        cv2.utils.logging.setLogLevel(level)
        if not video.isOpened():
            raise UnusableFile(
                path, 'unreadable', 'neither an .npz, a folder of images nor a video')
        check_frame_size(path, (int(video.get(cv2.CAP_PROP_FRAME_HEIGHT)),
                                int(video.get(cv2.CAP_PROP_FRAME_WIDTH))))
        return video

    def frames() -> Iterator[Frame]:
        video = opened()
        while True:
            found, image = video.read()
            if not found:
                video.release()
                return
            yield _grey(np.asarray(image), notes)

    rate_hz = float(opened().get(cv2.CAP_PROP_FPS))
    reader = _reader(path, frames, [], notes)
    reader.period_s = 1.0 / rate_hz if rate_hz > 0.0 else None
    return reader


def _reader(
    path: Path, frames: Callable[[], Iterator[Frame]], files: list[Path], notes: list[str],
) -> FrameReader:
    """Return a reader of frames; ``files`` are those that hold one frame each."""
    first = next(_checked(path, frames(), files), None)
    if first is None:
        raise UnusableFile(path, 'no frames', 'holds no frame')
    rows, cols = first.shape
    return FrameReader(
        lambda: _checked(path, frames(), files), (rows, cols), first.dtype, notes=notes)


def _checked(path: Path, frames: Iterator[Frame], files: list[Path]) -> Iterator[Frame]:
    """Yield frames of one size and type; name another one by its file or number."""
    first = ''
    for number, frame in enumerate(frames, start=1):
        source, where = (files[number - 1], '') if files else (path, f'frame {number}: ')
        frame = _storable(frame, source, where)
        kind = f'{frame.shape[1]} x {frame.shape[0]} pixels of {frame.dtype}'
        first = first or kind
        if kind != first:
            raise UnusableFile(source, 'mixed', f'{where}{kind}, the first frame has {first}')
        yield frame


def _storable(frame: Frame, source: Path, where: str) -> Frame:
    """Return an unsigned frame of 8 or 16 bits as it is, any other as 32-bit floating point."""
    if frame.ndim != 2 or 0 in frame.shape or frame.dtype.kind not in 'uif':
        raise UnusableFile(
            source, 'not frames',
            f'{where}{frame.dtype} of shape {frame.shape} is not a grey image')
    if frame.dtype.kind == 'u' and frame.itemsize <= 2:
        return frame.astype(frame.dtype.newbyteorder('='), copy=False)
    floats = frame.astype(np.float32)
    if not np.isfinite(floats).all():
        row, col = np.argwhere(~np.isfinite(floats))[0]
        raise UnusableFile(
            source, 'not finite', f'{where}row {row}, column {col} is not a finite number')
    return floats
