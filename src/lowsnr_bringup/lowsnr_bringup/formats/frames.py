# SPDX-License-Identifier: Apache-2.0
"""What every format gives: frames with their times, read one after the other."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from dataclasses import dataclass
from dataclasses import field
from importlib import import_module
from pathlib import Path
from typing import Any
from typing import NamedTuple

from lowsnr_bringup.bags.errors import UnusableFile
import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[Any]


class TimedFrame(NamedTuple):
    """
    A frame as the file holds it, and its time.

    Parameters
    ----------
    pixels : (rows, cols) or (rows, cols, channels) ndarray
        Channels are grey and perhaps alpha, or red, green, blue and perhaps alpha; a NaN is a
        blank pixel.
    time_ns : int or None
        Its time in the reckoning of the file [ns]; None where the file states none.

    """

    pixels: Pixels
    time_ns: int | None = None


@dataclass
class FrameSource:
    """
    The frames of one file.

    Parameters
    ----------
    path
        The file.
    frames
        Returns the frames from the first on.
    count : int or None
        Their number; None if it is not known before they are read.
    period_s : float or None
        Time between frames [s], if the file states one.
    absolute
        Whether the times are those since 1970 (UTC).
    start_ns : int or None
        When the first frame was taken, for the order of files [ns since 1970].
    truth : (T, 2) ndarray or None
        x (column), y (row) of the object [pixels], NaN where it is absent.
    notes : list of str
        What a user should know, without the path; complete once all frames are read.

    """

    path: Path
    frames: Callable[[], Iterator[TimedFrame]]
    count: int | None = None
    period_s: float | None = None
    absolute: bool = False
    start_ns: int | None = None
    truth: NDArray[np.floating] | None = None
    notes: list[str] = field(default_factory=list)


def library(path: Path, name: str, packages: str = '') -> Any:
    """
    Import a library that reads a format.

    Raises
    ------
    UnusableFile
        With reason ``no reader``; names the packages to install.

    """
    try:
        return import_module(name)
    except ImportError:
        raise UnusableFile(
            path, 'no reader', f'reading it takes a package that is not installed: python -m pip '
            f'install {packages or name}') from None
