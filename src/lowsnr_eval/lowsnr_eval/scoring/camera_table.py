# SPDX-License-Identifier: Apache-2.0
"""The table ``camera.csv``: where the scene lies in each image of a camera that moves."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from lowsnr_bringup.run import results_folder as files
from lowsnr_bringup.run.growing_file import GrowingFile
from lowsnr_common.core.frame_map import FrameMap
from lowsnr_eval.scoring import score_rows as rows
from lowsnr_eval.scoring.table_files import lines_backwards
from lowsnr_eval.scoring.table_files import lines_of
from lowsnr_eval.scoring.table_files import open_table
from lowsnr_eval.scoring.table_files import parsed

COLUMNS = ('stamp_s', 'binning', 'to_image_x', 'to_image_y')
_FARTHEST = 1e9


class View(NamedTuple):
    """Pixels along each side of a cell, and the place x, y of the scene in the image [pixels]."""

    binning: int = 1
    x: float = 0.0
    y: float = 0.0


def open_camera_table(folder: Path, resumed: bool) -> GrowingFile:
    """Open the table for appending; one that is continued is cut to its whole lines."""
    path = folder / files.CAMERA_FILE
    whole = next((stop for stop, _ in lines_backwards(path, COLUMNS)), 0) if resumed else None
    return open_table(path, COLUMNS, whole)


def camera_line(stamp: int, where: FrameMap) -> bytes:
    """Return the line of a frame with a stamp [ns]."""
    return rows.as_lines([[
        rows.stamp_text(stamp), where.binning, *(f'{each:.9g}' for each in where.to_image)]])


def read_views(folder: Path) -> dict[int, View] | None:
    """Return the view of each stamp [ns]; None of results without the table."""
    path = folder / files.CAMERA_FILE
    if not path.is_file():
        return None
    return dict(_views(path, lines_of(path, COLUMNS)))


def _views(path: Path, lines: Iterable[bytes]) -> Iterable[tuple[int, View]]:
    for line in lines:
        yield parsed(path, line, _view)


def _view(line: bytes) -> tuple[int, View]:
    stamp, binning, x, y = line.decode().strip().split(',')
    view = View(int(binning), float(x), float(y))
    if not (1 <= view.binning < _FARTHEST and abs(view.x) < _FARTHEST and abs(view.y) < _FARTHEST):
        raise ValueError(line)
    return rows.stamp_ns(stamp), view
