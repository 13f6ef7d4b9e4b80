# SPDX-License-Identifier: Apache-2.0
"""Truth in any of the usual forms, for the frames of a film or a bag."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterable
from collections.abc import Iterator
from pathlib import Path

from lowsnr_bringup.bags.compression import MAX_BYTES
from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.truth.boxes import is_mot
from lowsnr_bringup.truth.boxes import read_coco
from lowsnr_bringup.truth.boxes import read_mot
from lowsnr_bringup.truth.frame_index import FrameIndex
from lowsnr_bringup.truth.frame_index import Reading
from lowsnr_bringup.truth.frame_index import truth_at
from lowsnr_bringup.truth.table import read_table
from lowsnr_common.core.motion import POS
from lowsnr_common.core.records import Truth
import numpy as np
from numpy.typing import NDArray

Form = Callable[[Path, str, FrameIndex, Reading, list[str]], list[list[Truth]]]


def read_truth(
    path: Path, frames: FrameIndex, reading: Reading | None = None,
    remarks: list[str] | None = None,
) -> list[list[Truth]]:
    """
    Read truth from a CSV table, a MOT table or COCO annotations.

    Parameters
    ----------
    path
        The file.
    frames
        The frames that it is about.
    reading
        How it is read where its form leaves that open.
    remarks
        Receives what a user should know.

    Returns
    -------
    list of list of Truth
        Objects of every frame.

    Raises
    ------
    UnusableFile
        With reason ``unreadable``, ``header``, ``number``, ``no such frame`` or ``twice``; the
        sentence names the line.

    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise UnusableFile(path, 'too large', f'has more than {MAX_BYTES} bytes')
        text = path.read_text(encoding='utf-8-sig')
    except OSError as error:
        raise UnusableFile(path, 'unreadable', f'cannot be read: {error.strerror}') from None
    except UnicodeDecodeError as error:
        raise UnusableFile(
            path, 'unreadable', f'not a table of text: {" ".join(str(error).split())}') from None
    form: Form = read_table
    if text.lstrip().startswith('{'):
        form = read_coco
    elif is_mot(text):
        form = read_mot
    return form(path, text, frames, reading or Reading(), [] if remarks is None else remarks)


def truth_of_array(truth: NDArray[np.floating]) -> list[list[Truth]]:
    """Return the objects of every frame from positions (T, 2) [pixels], NaN for none."""
    return [[truth_at(x, y)] if np.isfinite(x + y) else [] for x, y in truth.astype(float)]


def within(
    objects: Iterable[list[Truth]], shape: tuple[int, int], source: Path, notes: list[str],
) -> Iterator[list[Truth]]:
    """
    Yield the objects of every frame that are in the picture, and note those that are not.

    Raises
    ------
    UnusableFile
        With reason ``outside``, if there are objects and none is in the picture.

    """
    rows, cols = shape
    outside = inside = 0
    example = ''
    for k, frame in enumerate(objects, start=1):
        kept = []
        for item in frame:
            x, y = (float(each) for each in item.state[POS])
            if -0.5 <= x < cols - 0.5 and -0.5 <= y < rows - 0.5:
                kept.append(item)
                continue
            example = example or f'{item.id} in frame {k} at x = {x:g}, y = {y:g}'
            outside += 1
        inside += len(kept)
        yield kept
    said = (f'{outside} of {outside + inside} positions are outside the picture of {cols} x '
            f'{rows} pixels ({example})')
    if outside and not inside:
        raise UnusableFile(source, 'outside', f'{said}; x is the column, y the row')
    if outside:
        notes.append(f'{source}: {said}; there they count as absent')
