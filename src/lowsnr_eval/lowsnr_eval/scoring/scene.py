# SPDX-License-Identifier: Apache-2.0
"""
The scene of a run: its frames and what they were answered with, for the report's animation.

``frames.f32`` holds the frames, each followed by its cells if it was conditioned, ``scene.jsonl``
a line for each of them with truth, detections and tracks.  Both grow frame by frame, so that the
report of an interrupted run has them too.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from collections.abc import Sequence
import json
import math
import os
from pathlib import Path
from typing import Any

from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.records import Truth
from lowsnr_eval.scoring.frame_scoring import Answer
from lowsnr_eval.scoring.scene_marks import marks
from lowsnr_eval.scoring.scene_marks import track_marks
import numpy as np

Plane = np.ndarray | None
SCENE_FILE = 'scene.jsonl'
PIXELS_FILE = 'frames.f32'
# A frame of more cells is reduced.
_MOST_CELLS = 2**17
# What a page can hold: the first frames of a run up to so many cells or letters.
_BUDGET = 2**24
# Frames that wait for their answers, and answers for their frames, where none is late.
WAITING = 32


def reduction(shape: tuple[int, int]) -> int:
    """Return the side of the blocks of cells that become one cell of what is kept."""
    return int(np.ceil(np.sqrt(shape[0] * shape[1] / _MOST_CELLS)))


def reduced(frame: np.ndarray, step: int) -> np.ndarray:
    """Return the brightest cell of each block of ``step`` x ``step`` cells, NaN if it has none."""
    # Rows first: they lie in one piece, and leave less to do for the columns.
    return np.asarray(
        _brightest(_brightest(frame, step).T, step).T.astype(np.float32, casting='same_kind'))


def _brightest(plane: np.ndarray, step: int) -> np.ndarray:
    """Return the largest of each ``step`` rows."""
    most = plane[::step].copy()
    for start in range(1, step):
        rows = plane[start::step]
        np.fmax(most[:len(rows)], rows, out=most[:len(rows)])
    return most


class SceneWriter:
    """
    Writer of the scene of a run; :meth:`close` it at the end.

    A frame, its cells and its answers arrive in any order.  The writer writes them when it has
    all, or when a later one shows that a frame, or its cells, will not arrive.  The files hold at
    most 64 MB of frames and 16 MB of text, the first of the run; after that, or where the disk is
    full, the writer is ``full`` and ignores what it is given.

    Parameters
    ----------
    folder
        Results folder, which exists.
    cell_size_m
        Side of a cell [m].
    resumed
        Whether to continue the files of an earlier process.
    conditioned
        Whether frames have conditioned cells.
    most_waiting
        Frames that are kept until their answers arrive, and answers until their frames do.

    """

    def __init__(
        self, folder: Path, cell_size_m: float, resumed: bool = False, conditioned: bool = False,
        most_waiting: int = WAITING,
    ) -> None:
        self._cell_size_m, self._most_waiting = cell_size_m, most_waiting
        self._letters, self._numbers = _cut_to_whole(folder) if resumed else (0, 0)
        self._frames: dict[int, tuple[int, np.ndarray]] = {}
        self._cells: dict[int, tuple[dict[str, Any], np.ndarray]] = {}
        self._awaited: tuple[dict[int, Any], ...] = (
            self._frames, self._cells)[:1 + conditioned]
        self._answers: deque[tuple[int, dict[str, Any]]] = deque()
        self.full = max(self._letters, self._numbers) > _BUDGET
        self._lines, self._pixels = (
            (folder / name).open('ab' if resumed else 'wb', buffering=0)
            for name in (SCENE_FILE, PIXELS_FILE))

    def add_frame(self, stamp: int, frame: np.ndarray) -> None:
        """Add a frame (rows, cols) with its stamp [ns]."""
        if self.full:
            return
        step = reduction(frame.shape)
        self._keep(self._frames, stamp, (step, reduced(frame, step).astype('<f4')))

    def add_cells(self, stamp: int, cells: np.ndarray, where: FrameMap) -> None:
        """Add the conditioned cells (rows, cols) of the frame with a stamp [ns]."""
        if self.full:
            return
        step = reduction(cells.shape)
        kept = reduced(cells, step).astype('<f4')
        # The edge of the first cell in the image; pixel centres are whole numbers.
        corner = where.pixels(np.zeros(2)) - where.binning / 2.0
        self._keep(self._cells, stamp, ({
            'shape': list(kept.shape), 'side': step * where.binning,
            'corner': corner.round(3).tolist()}, kept))

    def _keep(self, kept: dict[int, Any], stamp: int, item: Any) -> None:
        """Keep a frame, or cells, until the answers arrive."""
        kept[stamp] = item
        if len(kept) > self._most_waiting:
            del kept[min(kept)]
        self._write(self._most_waiting)

    def add_answers(
        self, number: int, stamp: int, truth: Sequence[Truth] | None,
        answers: Mapping[str, Answer],
    ) -> None:
        """Add the truth, None if unknown, and the answers of the frame with a stamp [ns]."""
        if self.full:
            return
        self._answers.append((stamp, {
            'frame': number, 'truth': marks(truth, self._cell_size_m),
            'chains': {name: {
                'detections': marks(answer.detections, self._cell_size_m),
                'tracks': track_marks(answer.tracks, self._cell_size_m)}
                for name, answer in answers.items()}}))
        self._write(self._most_waiting)

    def flush(self) -> None:
        """Write the answers whose frames have not arrived."""
        self._write(0)

    def give_way(self) -> None:
        """Give the room that the files take to others: they are empty from now on."""
        self._fill()
        for file in (self._lines, self._pixels):
            file.truncate(0)

    def close(self) -> None:
        """Write what waits and close the files."""
        self.flush()
        self._lines.close()
        self._pixels.close()

    def _write(self, most_waiting: int) -> None:
        """Write what is complete, and the oldest answers where more than this many wait."""
        while self._answers and not self.full:
            stamp, line = self._answers[0]
            # Frames arrive in order: none arrives after a later one.
            newest = min(max(kept, default=-1) for kept in self._awaited)
            if newest < stamp and len(self._answers) <= most_waiting:
                return
            self._answers.popleft()
            step, frame = self._frames.pop(stamp, (1, None))
            place, cells = self._cells.pop(stamp, (None, None))
            self._append(line | {
                'step': step, 'shape': None if frame is None else list(frame.shape),
                'cells': place}, [item for item in (frame, cells) if item is not None])
            for kept in self._awaited:
                for old in [key for key in kept if key < stamp]:
                    del kept[old]

    def _append(self, line: dict[str, Any], planes: Sequence[np.ndarray]) -> None:
        text = f'{json.dumps(line)}\n'.encode()
        pixels = b''.join(plane.tobytes() for plane in planes)
        self._letters += len(text)
        self._numbers += len(pixels) // 4
        try:
            self.full = max(self._letters, self._numbers) > _BUDGET or (
                self._pixels.write(pixels) + self._lines.write(text) < len(pixels) + len(text))
        except OSError:
            self.full = True
        if self.full:
            self._fill()

    def _fill(self) -> None:
        """Take nothing from now on."""
        self.full = True
        for kept in self._awaited:
            kept.clear()
        self._answers.clear()


def _cut_to_whole(folder: Path) -> tuple[int, int]:
    """Cut both files to their complete frames; return the letters and cells that remain."""
    letters = cells = 0
    if not any((folder / name).exists() for name in (SCENE_FILE, PIXELS_FILE)):
        return letters, cells  # the earlier process died before it began them
    try:
        most = (folder / PIXELS_FILE).stat().st_size // 4
        for text in (folder / SCENE_FILE).read_bytes().splitlines(keepends=True):
            size = sum(map(math.prod, _shapes(json.loads(text))))
            if not text.endswith(b'\n') or cells + size > most:
                break
            letters, cells = letters + len(text), cells + size
        os.truncate(folder / SCENE_FILE, letters)
        os.truncate(folder / PIXELS_FILE, 4 * cells)
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        letters = cells = _BUDGET + 1  # add nothing to what cannot be read
    return letters, cells


def _shapes(line: dict[str, Any]) -> list[tuple[int, int]]:
    """Return rows and columns of the frame of a line and of its cells, (0, 0) for none."""
    found = line['shape'], (line.get('cells') or {'shape': None})['shape']
    return [(int(shape[0]), int(shape[1])) if shape else (0, 0) for shape in found]


def read_scene(folder: Path) -> tuple[list[dict[str, Any]], list[Plane], list[Plane]]:
    """
    Read the scene of a run.

    Returns
    -------
    list of dict
        What each line of ``scene.jsonl`` holds, without a last line that a crash cut off.
    list of ndarray or None
        The (rows, cols) frame of each.
    list of ndarray or None
        The (rows, cols) conditioned cells of each.

    """
    lines: list[dict[str, Any]] = []
    frames: list[Plane] = []
    cells: list[Plane] = []
    with (folder / PIXELS_FILE).open('rb') as pixels:
        for text in (folder / SCENE_FILE).read_text(encoding='utf-8').split('\n')[:-1]:
            lines.append(json.loads(text))
            for kept, shape in zip((frames, cells), _shapes(lines[-1]), strict=True):
                data = pixels.read(4 * math.prod(shape))
                kept.append(np.frombuffer(data, '<f4').reshape(shape) if data else None)
    return lines, frames, cells
