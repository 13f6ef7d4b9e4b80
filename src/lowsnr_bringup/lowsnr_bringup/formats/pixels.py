# SPDX-License-Identifier: Apache-2.0
"""Pixels as they are stored in a bag: of one size and type, at their depth, checked."""

from __future__ import annotations

from pathlib import Path

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats.frames import Pixels
from lowsnr_common.images.image_encodings import LARGEST
from lowsnr_common.images.image_encodings import luminance
import numpy as np
from numpy.typing import NDArray

Frame = NDArray[np.integer | np.floating]

_GREY = 'colour frames are converted to grey'
# A step between neighbouring numbers may be at most this part of the noise.
_COARSEST = 0.25


class Storing:
    """
    What the frames of a film have in common, and how many of their pixels are blank.

    Parameters
    ----------
    remarks
        Receives what a user should know.

    """

    def __init__(self, remarks: list[str]) -> None:
        self._remarks = remarks
        self.begin()

    def begin(self) -> None:
        """Start with the first frame."""
        self._kind = ''
        self._number = self._blank = self._blank_frames = self._seen = 0

    def storable(self, pixels: Pixels, source: Path, where: str) -> Frame:
        """
        Return an unsigned frame of 8 or 16 bits as it is, any other as 32-bit floating point.

        Raises
        ------
        UnusableFile
            With reason ``not frames``, ``too large``, ``too fine`` or ``mixed``; ``where`` is
            'frame' if the number of the frame has to be said.

        """
        self._number += 1
        where = f'frame {self._number}: ' if where else ''
        frame = self._converted(pixels, source, where)
        kind = f'{frame.shape[1]} x {frame.shape[0]} pixels of {frame.dtype}'
        self._kind = self._kind or kind
        if kind != self._kind:
            raise UnusableFile(
                source, 'mixed', f'{where}{kind}, the first frame has {self._kind}')
        return frame

    def end(self, path: Path) -> None:
        """Note what is blank, after the last frame; UnusableFile if everything is."""
        if self._number and not self._seen:
            raise UnusableFile(path, 'not finite', 'no pixel of any frame is a finite number')
        note = (f'{self._blank} pixels of {self._blank_frames} frames are blank and stored as NaN '
                '(unobserved)')
        if self._blank and note not in self._remarks:
            self._remarks.append(note)

    def _converted(self, pixels: Pixels, source: Path, where: str) -> Frame:
        frame = luminance(pixels)
        if frame is not pixels and frame.base is None and _GREY not in self._remarks:
            self._remarks.append(_GREY)
        if frame.ndim != 2 or 0 in frame.shape or frame.dtype.kind not in 'buif':
            raise UnusableFile(
                source, 'not frames',
                f'{where}{pixels.dtype} of shape {pixels.shape} is not an image')
        if frame.dtype.kind in 'bu' and frame.itemsize <= 2:
            self._seen += 1
            kind = frame.dtype.newbyteorder('=') if frame.dtype.kind == 'u' else np.uint8
            return frame.astype(kind, copy=False)
        return self._as_floats(frame, source, where)

    def _as_floats(self, frame: Pixels, source: Path, where: str) -> Frame:
        with np.errstate(over='ignore'):
            floats: NDArray[np.float32] = frame.astype(np.float32)
        finite = np.isfinite(floats)
        blank = int(finite.size - np.count_nonzero(finite))
        if blank:
            if frame.dtype.kind == 'f' and np.isfinite(frame).sum() > finite.size - blank:
                raise _too_large(source, where)
            floats[~finite] = np.nan
            self._blank += blank
            self._blank_frames += 1
        seen = floats[finite] if blank else floats
        if seen.size:
            self._seen += 1
            if max(abs(float(seen.min())), abs(float(seen.max()))) > LARGEST:
                raise _too_large(source, where)
        if self._number == 1 and frame.dtype.itemsize > 2 and frame.dtype != np.float32:
            check_steps(frame, floats, source, where)
        return floats


def _too_large(source: Path, where: str) -> UnusableFile:
    return UnusableFile(
        source, 'too large', f'{where}has numbers beyond 1e9; divide the frames by a constant')


def check_steps(
    frame: Pixels, floats: NDArray[np.float32], source: Path, where: str,
) -> None:
    """Raise UnusableFile if 32-bit floating point does not resolve the noise of a frame."""
    steps = np.abs(np.diff(frame.astype(np.float64), axis=1))
    noise = float(np.nanmedian(steps)) if np.isfinite(steps).any() else 0.0
    spacing = float(np.spacing(np.nanmax(np.abs(floats)))) if np.isfinite(floats).any() else 0.0
    if 0.0 < _COARSEST * noise < spacing:
        raise UnusableFile(
            source, 'too fine', f'{where}32-bit floating point has steps of {spacing:g} at its '
            f'level, and its pixels differ by {noise:g}; subtract a constant from the frames')
