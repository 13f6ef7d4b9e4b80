# SPDX-License-Identifier: Apache-2.0
"""The frames of a film, of one size and type, with their stamps."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from dataclasses import dataclass
from dataclasses import field
from pathlib import Path

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats.frames import TimedFrame
from lowsnr_bringup.formats.pixels import Frame
from lowsnr_common.core.timeline import in_seconds
import numpy as np
from numpy.typing import NDArray

_LATEST_NS = 2**31 * 10**9  # a stamp has the seconds since 1970 in 31 bits


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
    period_s : float or None
        Time between frames [s], if the files state one.
    absolute
        Whether the times of the frames are those since 1970.
    truth : (T, 2) ndarray or None
        x (column), y (row) of the object [pixels], NaN where it is absent; None if unknown.
    files
        Names of the files of a folder, if each holds one frame.
    notes : list of str
        What a user should know, complete once all frames are read.

    """

    frames: Callable[[], Iterator[TimedFrame]]
    shape: tuple[int, int]
    dtype: np.dtype[np.integer | np.floating]
    count: int | None = None
    period_s: float | None = None
    absolute: bool = False
    truth: NDArray[np.floating] | None = None
    files: tuple[str, ...] = ()
    notes: list[str] = field(default_factory=list)
    path: Path = Path()

    def __iter__(self) -> Iterator[Frame]:
        return (frame.pixels for frame in self.frames())

    def times_s(self, period_s: float | None = None) -> NDArray[np.floating]:
        """Return the times of all frames [s]: their own, or from 0 on; reads the frames."""
        even_s = period_s or self.period_s or 1.0
        return np.array([
            k * even_s if period_s or frame.time_ns is None else frame.time_ns / 1e9
            for k, frame in enumerate(self.frames())])

    def stamped(self, period_s: float | None = None) -> Iterator[tuple[Frame, int]]:
        """
        Yield every frame with its stamp [ns].

        Times since 1970 are the stamps; others are counted from the first frame, whose stamp is
        a period.  ``period_s`` replaces the times of the files; the period is 1 s where neither
        states one.

        Raises
        ------
        UnusableFile
            With reason ``stamps``, if they do not increase, or end after 2038.

        """
        even_s = period_s or self.period_s or 1.0
        first_ns = last_ns = 0
        for k, (pixels, time_ns) in enumerate(self.frames(), start=1):
            if period_s or time_ns is None:
                stamp_ns = round(k * even_s * 1e9)
            else:
                first_ns = time_ns if k == 1 else first_ns
                stamp_ns = time_ns + (0 if self.absolute else round(even_s * 1e9) - first_ns)
            if stamp_ns <= last_ns:
                raise UnusableFile(
                    self.path, 'stamps', f'frame {k} has the time {in_seconds(stamp_ns)} s, which '
                    f'is not after {in_seconds(last_ns)} s of the one before; --period gives the '
                    'time between frames')
            if stamp_ns >= _LATEST_NS:
                raise UnusableFile(
                    self.path, 'stamps', f'frame {k} has the time {in_seconds(stamp_ns)} s, which '
                    'a ROS stamp cannot hold: times are in seconds; --period gives the time '
                    'between frames')
            last_ns = stamp_ns
            yield pixels, stamp_ns
