"""
Frames from files: ``.npz`` archives, folders of images, videos; pixels as they are.

What does not fit raises ValueError with one line that names the file.  A colour image becomes
its grey, by luminance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
import re
import struct
import tokenize
import zipfile
import zlib

from lowsnr_common.settings.text import one_line
import numpy as np

IMAGE_ENDINGS = ('.png', '.tif', '.tiff', '.fits', '.fit', '.fts')
_FITS = ('.fits', '.fit', '.fts')
# What reading a file that holds anything at all may raise.
UNREADABLE = (
    OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, MemoryError,
    RuntimeError, SyntaxError, EOFError, AssertionError, struct.error, zlib.error,
    tokenize.TokenError, zipfile.BadZipFile)
_GREY = 'colour frames are turned to grey'


@dataclass
class Recording:
    """
    Frames that are read one by one.

    Parameters
    ----------
    frames
        The frames (rows, cols), all of one size and kind; to be gone through once.
    times_s : (T,) ndarray
        Their times [s], rising; None where not known.
    truth : (T, 2) ndarray
        Place x (column), y (row) of the object [pixels], NaN where there is none; None where
        not known.
    period_s
        Time from a frame to the next [s], for a video; None otherwise.
    remarks
        What a user should know, after the frames were gone through.

    """

    frames: Iterator[np.ndarray]
    times_s: np.ndarray | None
    truth: np.ndarray | None
    period_s: float | None
    remarks: list[str]


def open_recording(path: Path) -> Recording:
    """
    Open an ``.npz``, a folder of images or a video.

    Raises
    ------
    ValueError
        One line, now or while the frames are gone through.

    """
    if not path.exists():
        raise ValueError(f'{path}: there is no such file or folder')
    if path.is_dir():
        return _folder(path)
    return _archive(path) if path.suffix == '.npz' else _video(path)


def _archive(path: Path) -> Recording:
    try:
        with path.open('rb') as file, np.load(file, allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in ('frames', 'truth', 't_s') if key in archive}
    except UNREADABLE as error:
        raise ValueError(f'{path}: cannot be read: {one_line(error)}') from None
    if 'frames' not in arrays:
        raise ValueError(f'{path}: has no array frames')
    frames, truth, times_s = arrays['frames'], arrays.get('truth'), arrays.get('t_s')
    if frames.ndim != 3 or 0 in frames.shape:
        raise ValueError(f'{path}: frames has shape {frames.shape}, must be (frames, rows, cols)')
    for name, array, shape in (
            ('truth', truth, (len(frames), 2)), ('t_s', times_s, (len(frames),))):
        if array is not None and (array.shape != shape or array.dtype.kind not in 'fiu'):
            raise ValueError(
                f'{path}: {name} has shape {array.shape} of {array.dtype}, must be {shape} of '
                'numbers')
    if times_s is not None and not (
            np.isfinite(times_s).all() and (np.diff(times_s.astype(float)) > 0.0).all()):
        raise ValueError(f'{path}: t_s does not rise from frame to frame')
    return Recording(_checked(path, iter(frames), []), times_s, truth, None, [])


def _folder(path: Path) -> Recording:
    files = sorted(
        (item for item in path.iterdir() if item.suffix.lower() in IMAGE_ENDINGS), key=_by_number)
    if not files:
        raise ValueError(f'{path}: holds no image ({", ".join(IMAGE_ENDINGS)})')
    remarks: list[str] = []
    frames = (_image(item, remarks) for item in files)
    return Recording(_checked(path, frames, files), None, None, None, remarks)


def _by_number(path: Path) -> list[tuple[int, str]]:
    """Return a key that puts frame_9 before frame_10."""
    return [(int(part), '') if part.isdigit() else (-1, part)
            for part in re.split(r'(\d+)', path.name)]


def _image(path: Path, remarks: list[str]) -> np.ndarray:
    if path.suffix.lower() in _FITS:
        from astropy.io import fits  # slow to import, and rarely needed
        try:
            data = fits.getdata(path)
        except (*UNREADABLE, fits.VerifyError) as error:
            raise ValueError(f'{path}: not a FITS image: {one_line(error)}') from None
        return np.asarray(data)
    import cv2
    try:
        data = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED) \
            if path.stat().st_size else None
    except (OSError, cv2.error) as error:
        raise ValueError(f'{path}: not an image: {one_line(error)}') from None
    if data is None:
        raise ValueError(f'{path}: not an image')
    return _grey(np.asarray(data), remarks)


def _grey(image: np.ndarray, remarks: list[str]) -> np.ndarray:
    """Return one channel of an image as OpenCV has it: blue, green, red and perhaps alpha."""
    if image.ndim == 2:
        return image
    if (image[..., :3] == image[..., :1]).all():
        return image[..., 0]
    import cv2
    if _GREY not in remarks:
        remarks.append(_GREY)
    return np.asarray(cv2.cvtColor(image[..., :3], cv2.COLOR_BGR2GRAY))


def _video(path: Path) -> Recording:
    import cv2
    quiet = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    video = cv2.VideoCapture(str(path))
    cv2.utils.logging.setLogLevel(quiet)
    if not video.isOpened():
        raise ValueError(f'{path}: neither an .npz, a folder of images nor a video')
    rate_hz = float(video.get(cv2.CAP_PROP_FPS))
    remarks: list[str] = []

    def frames() -> Iterator[np.ndarray]:
        while True:
            found, image = video.read()
            if not found:
                video.release()
                return
            yield _grey(np.asarray(image), remarks)

    period_s = 1.0 / rate_hz if rate_hz > 0.0 else None
    return Recording(_checked(path, frames(), []), None, None, period_s, remarks)


def _checked(
    path: Path, frames: Iterator[np.ndarray], files: list[Path],
) -> Iterator[np.ndarray]:
    """Pass on frames of one size and kind; raise ValueError for another, by number or file."""
    first = None
    for number, frame in enumerate(frames, start=1):
        where = f'{files[number - 1]}' if files else f'{path}: frame {number}'
        frame = _storable(frame, where)
        kind = f'{frame.shape[1]} x {frame.shape[0]} pixels of {frame.dtype}'
        first = first or kind
        if kind != first:
            raise ValueError(f'{where}: {kind}, the first frame has {first}')
        yield frame
    if first is None:
        raise ValueError(f'{path}: holds no frame')


def _storable(frame: np.ndarray, where: str) -> np.ndarray:
    """Return a frame of 8 or 16 bits without sign as it is, others as 32-bit floats."""
    if frame.ndim != 2 or 0 in frame.shape or frame.dtype.kind not in 'uif':
        raise ValueError(f'{where}: {frame.dtype} of shape {frame.shape} is not a grey image')
    if frame.dtype.kind == 'u' and frame.itemsize <= 2:
        return frame.astype(frame.dtype.newbyteorder('='), copy=False)
    floats = frame.astype(np.float32)
    if not np.isfinite(floats).all():
        row, col = np.argwhere(~np.isfinite(floats))[0]
        raise ValueError(f'{where}: row {row}, column {col} is not a finite number')
    return floats
