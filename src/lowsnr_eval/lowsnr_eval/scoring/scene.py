"""
What a run showed and what was said of it, kept so that a report can play it back.

``frames.f32`` holds the frames, ``scene.jsonl`` a line for each of them with truth, detections
and tracks.  Both grow frame by frame, so that an interrupted run can be looked at too.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from collections.abc import Sequence
from contextlib import ExitStack
import json
import math
import os
from pathlib import Path
from types import TracebackType
from typing import Any

from lowsnr_common.core.motion import POS
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Truth
from lowsnr_eval.scoring.frame_scoring import Answer
import numpy as np

SCENE_FILE = 'scene.jsonl'
PIXELS_FILE = 'frames.f32'
# A frame of more cells is kept reduced.
_MOST_CELLS = 2**17
# Of a run, what a page can hold: its first frames up to as many cells or letters.
_BUDGET = 2**24
# Frames or scores kept while the other half is on its way.
WAITING = 32


def reduction(shape: tuple[int, int]) -> int:
    """Return the side of the blocks of cells that become one cell of what is kept."""
    return int(np.ceil(np.sqrt(shape[0] * shape[1] / _MOST_CELLS)))


def reduced(frame: np.ndarray, step: int) -> np.ndarray:
    """Return the brightest cell of each block of ``step`` x ``step`` cells, (rows, cols)."""
    blocks = np.full([-(-size // step) for size in frame.shape], -np.inf, np.float32)
    for row, col in np.ndindex(step, step):
        cells = frame[row::step, col::step]
        part = blocks[:cells.shape[0], :cells.shape[1]]
        np.maximum(part, cells, out=part, casting='same_kind')
    return blocks


class SceneWriter:
    """
    Writer of the scene of a run; use it in ``with``.

    A frame and what was said of it come in any order; they are written when both are there, or
    when the frame will not come.  The files hold at most 64 MB of frames and 16 MB of marks, the
    first of the run; after that, or where the disk is full, the writer is ``full`` and takes no
    notice.

    Parameters
    ----------
    folder
        Results folder, which exists.
    cell_size_m
        Side of a cell [m].
    resumed
        Whether it goes on behind what stands in the files.

    """

    def __init__(self, folder: Path, cell_size_m: float, resumed: bool = False) -> None:
        self._cell_size_m = cell_size_m
        self._letters, self._cells = _cut_to_whole(folder) if resumed else (0, 0)
        self._frames: dict[int, tuple[int, np.ndarray]] = {}
        self._said: deque[tuple[int, dict[str, Any]]] = deque()
        self.full = max(self._letters, self._cells) > _BUDGET
        self._files = ExitStack()
        self._lines, self._pixels = (
            self._files.enter_context((folder / name).open('ab' if resumed else 'wb', buffering=0))
            for name in (SCENE_FILE, PIXELS_FILE))

    def __enter__(self) -> SceneWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def see(self, stamp: int, frame: np.ndarray) -> None:
        """Take a frame (rows, cols)."""
        if self.full:
            return
        step = reduction(frame.shape)
        self._frames[stamp] = step, reduced(frame, step).astype('<f4')
        if len(self._frames) > WAITING:
            del self._frames[min(self._frames)]
        self._write(WAITING)

    def say(
        self, number: int, stamp: int, truth: Sequence[Truth], answers: Mapping[str, Answer],
    ) -> None:
        """Take what is true and what was answered of the frame with a stamp."""
        if self.full:
            return
        self._said.append((stamp, {
            'frame': number, 'truth': self._marks(truth),
            'chains': {name: {
                'detections': self._marks(answer.detections or ()),
                'tracks': self._marks(answer.tracks or ())}
                for name, answer in answers.items()}}))
        self._write(WAITING)

    def flush(self) -> None:
        """Write what was said of frames that have not come."""
        self._write(0)

    def close(self) -> None:
        """Write what waits and close the files."""
        self.flush()
        self._files.close()

    def _write(self, most_waiting: int) -> None:
        """Write what is whole, and the oldest where more than this many wait."""
        while self._said and not self.full:
            stamp, line = self._said[0]
            # Frames come in order: one that a later one has overtaken does not come.
            if max(self._frames, default=-1) < stamp and len(self._said) <= most_waiting:
                return
            self._said.popleft()
            step, frame = self._frames.pop(stamp, (1, None))
            self._append(line | {
                'step': step, 'shape': None if frame is None else list(frame.shape)}, frame)
            for old in [key for key in self._frames if key < stamp]:
                del self._frames[old]

    def _append(self, line: dict[str, Any], frame: np.ndarray | None) -> None:
        text = f'{json.dumps(line)}\n'.encode()
        pixels = b'' if frame is None else frame.tobytes()
        self._letters += len(text)
        self._cells += len(pixels) // 4
        try:
            self.full = max(self._letters, self._cells) > _BUDGET or (
                self._pixels.write(pixels) + self._lines.write(text) < len(pixels) + len(text))
        except OSError:
            self.full = True
        if self.full:
            self._frames.clear()
            self._said.clear()

    def _marks(self, items: Sequence[Truth] | Sequence[Estimate]) -> list[list[Any]]:
        """Return column, row and id of each that has a place."""
        places = [(*(item.state[POS] / self._cell_size_m).tolist(), item.id) for item in items]
        return [[round(x, 3), round(y, 3), name] for x, y, name in places
                if np.isfinite(x) and np.isfinite(y)]


def _cut_to_whole(folder: Path) -> tuple[int, int]:
    """Cut both files to the frames that are whole; return the letters and cells left."""
    letters = cells = 0
    try:
        most = (folder / PIXELS_FILE).stat().st_size // 4
        for text in (folder / SCENE_FILE).read_bytes().splitlines(keepends=True):
            size = math.prod(json.loads(text)['shape'] or [0])
            if not text.endswith(b'\n') or cells + size > most:
                break
            letters, cells = letters + len(text), cells + size
        os.truncate(folder / SCENE_FILE, letters)
        os.truncate(folder / PIXELS_FILE, 4 * cells)
    except (OSError, ValueError, KeyError, TypeError):
        letters = cells = _BUDGET + 1  # nothing is to be added to what cannot be read
    return letters, cells


def read_scene(folder: Path) -> tuple[list[dict[str, Any]], list[np.ndarray | None]]:
    """
    Read the scene of a run.

    Returns
    -------
    list of dict
        What each line of ``scene.jsonl`` holds; a line cut off by a crash is left out.
    list of ndarray or None
        The (rows, cols) frame of each.

    """
    lines, frames = [], []
    with (folder / PIXELS_FILE).open('rb') as pixels:
        for text in (folder / SCENE_FILE).read_text(encoding='utf-8').split('\n')[:-1]:
            line = json.loads(text)
            frame = None
            if line['shape'] is not None:
                rows, cols = line['shape']
                data = pixels.read(4 * rows * cols)
                frame = np.frombuffer(data, '<f4').reshape(rows, cols)
            lines.append(line)
            frames.append(frame)
    return lines, frames
