# SPDX-License-Identifier: Apache-2.0
"""Writing the scene of a run, for the report's animation, while the run goes on."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from collections.abc import Sequence
import json
from pathlib import Path
from typing import Any

from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.records import Truth
from lowsnr_eval.scene.scene_files import BUDGET
from lowsnr_eval.scene.scene_files import cut_to_whole
from lowsnr_eval.scene.scene_files import PIXELS_FILE
from lowsnr_eval.scene.scene_files import reduced
from lowsnr_eval.scene.scene_files import reduction
from lowsnr_eval.scene.scene_files import SCENE_FILE
from lowsnr_eval.scene.scene_marks import marks
from lowsnr_eval.scene.scene_marks import track_marks
from lowsnr_eval.scoring.frame_scoring import Answer
import numpy as np

# Frames that wait for their answers, and answers for their frames, where none is late.
WAITING = 32
Place = dict[str, Any]  # of a plane in the frame: shape, side of its cells, corner of the first
Kept = dict[int, tuple[Place, np.ndarray]]  # planes and their places by stamp


def place_in_frame(shape: tuple[int, int], where: FrameMap | None) -> tuple[Place, int]:
    """
    Return the place of cells (rows, cols) in the frame, and the side of the blocks kept of them.

    ``where`` is the map of the frame, None if it was not conditioned.
    """
    step, binning = reduction(shape), where.binning if where else 1
    # The edge of the first cell in the image; pixel centres are whole numbers.
    first = where.pixels(np.zeros(2)) if where else np.zeros(2)
    return {'side': step * binning, 'corner': (first - binning / 2.0).round(3).tolist()}, step


class SceneWriter:
    """
    Writer of the scene of a run; :meth:`close` it at the end.

    A frame, its other planes and its answers arrive in any order.  The writer writes them when it
    has all, or when a later one shows that a frame, or a plane, will not arrive.  The files hold
    at most 64 MB of planes and 16 MB of text, the first of the run; after that, or where the disk
    is full, the writer is ``full`` and ignores what it is given.

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
    statistics
        Names of the chains whose statistic is added.
    most_waiting
        Frames that are kept until their answers arrive, and answers until their frames do.

    """

    def __init__(
        self, folder: Path, cell_size_m: float, resumed: bool = False, conditioned: bool = False,
        most_waiting: int = WAITING, statistics: Sequence[str] = (),
    ) -> None:
        self._cell_size_m, self._most_waiting = cell_size_m, most_waiting
        self._letters, self._numbers = cut_to_whole(folder) if resumed else (0, 0)
        self._frames, self._cells = Kept(), Kept()
        self._statistics = {name: Kept() for name in statistics}
        self._awaited = (
            self._frames, *[self._cells] * conditioned, *self._statistics.values())
        self._conditioned = conditioned
        self._answers: deque[tuple[int, dict[str, Any]]] = deque()
        self.full = max(self._letters, self._numbers) > BUDGET
        self._lines, self._pixels = (
            (folder / name).open('ab' if resumed else 'wb', buffering=0)
            for name in (SCENE_FILE, PIXELS_FILE))

    def add_frame(self, stamp: int, frame: np.ndarray) -> None:
        """Add a frame (rows, cols) with its stamp [ns]."""
        self._keep(self._frames, stamp, frame, None)

    def add_cells(self, stamp: int, cells: np.ndarray, where: FrameMap) -> None:
        """Add the conditioned cells (rows, cols) of the frame with a stamp [ns]."""
        self._keep(self._cells, stamp, cells, where)

    def add_statistic(self, name: str, stamp: int, plane: np.ndarray) -> None:
        """Add what a chain publishes of the frame, or of its cells, as ``statistic``."""
        self._keep(self._statistics[name], stamp, plane, None)

    def _keep(
        self, kept: Kept, stamp: int, plane: np.ndarray, where: FrameMap | None,
    ) -> None:
        """Keep a plane until the answers arrive."""
        if self.full:
            return
        place, step = place_in_frame((plane.shape[0], plane.shape[1]), where)
        pixels = reduced(plane, step).astype('<f4')
        kept[stamp] = {'shape': list(pixels.shape), **place}, pixels
        if len(kept) > self._most_waiting:
            oldest = min(kept)
            self._write(self._most_waiting, oldest)
            kept.pop(oldest, None)
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

    def _write(self, most_waiting: int, until: int = -1) -> None:
        """
        Write what is complete, and the oldest answers where more than this many wait.

        Answers up to the stamp ``until`` are written with the planes that there are.
        """
        while self._answers and not self.full:
            stamp, line = self._answers[0]
            # Frames arrive in order: none arrives after a later one.
            newest = min(max(kept, default=-1) for kept in self._awaited)
            if newest < stamp and stamp > until and len(self._answers) <= most_waiting:
                return
            self._answers.popleft()
            found = [self._frames.pop(stamp, None), self._cells.pop(stamp, None)]
            frame, cells = (each and each[0] for each in found)
            for name, chain in line['chains'].items():
                plane = self._statistics.get(name, {}).pop(stamp, None)
                place = plane and (cells if self._conditioned else plane[0])
                if place:
                    chain['statistic'] = place
                    found.append(plane)
            self._append(line | {
                'step': frame['side'] if frame else 1, 'shape': frame and frame['shape'],
                'cells': cells}, [each[1] for each in found if each])
            for kept in self._awaited:
                for old in [key for key in kept if key < stamp]:
                    del kept[old]

    def _append(self, line: dict[str, Any], planes: Sequence[np.ndarray]) -> None:
        text = f'{json.dumps(line)}\n'.encode()
        pixels = b''.join(plane.tobytes() for plane in planes)
        self._letters += len(text)
        self._numbers += len(pixels) // 4
        try:
            self.full = max(self._letters, self._numbers) > BUDGET or (
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
