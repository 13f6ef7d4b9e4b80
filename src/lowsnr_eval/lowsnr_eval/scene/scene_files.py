# SPDX-License-Identifier: Apache-2.0
"""
The files of a scene, and the pictures in them.

``scene.jsonl`` has a line for each frame, with truth, detections and tracks.  ``frames.f32`` has
the frame of each line, its cells if it was conditioned, and the statistic of each chain that
publishes it.  Both grow frame by frame, so that the report of an interrupted run has them too.
"""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any
from typing import NamedTuple

import numpy as np

Plane = np.ndarray | None
SCENE_FILE = 'scene.jsonl'
PIXELS_FILE = 'frames.f32'
# What a page can hold: the first frames of a run up to so many cells or letters.
BUDGET = 2**24
# A frame of more cells is reduced.
_MOST_CELLS = 2**17


class Scene(NamedTuple):
    """
    The scene of a run, read.

    ``lines`` is what each line of ``scene.jsonl`` holds, without a last one that a crash cut
    off.  ``frames`` and ``cells`` are the (rows, cols) frame of each, and its conditioned cells;
    ``statistics`` the (rows, cols) statistic of each chain that has one, minus its threshold.
    """

    lines: list[dict[str, Any]]
    frames: list[Plane]
    cells: list[Plane]
    statistics: list[dict[str, np.ndarray]]


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


def _shapes(line: dict[str, Any]) -> list[tuple[int, int]]:
    """Return rows and columns of the planes of a line, (0, 0) for none, frame and cells first."""
    chains = line.get('chains', {}).values()
    places = [line.get('cells'), *(each.get('statistic') for each in chains)]
    found = [line['shape'], *(place and place['shape'] for place in places)]
    return [(int(shape[0]), int(shape[1])) if shape else (0, 0) for shape in found]


def cut_to_whole(folder: Path) -> tuple[int, int]:
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
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        letters = cells = BUDGET + 1  # add nothing to what cannot be read
    return letters, cells


def read_scene(folder: Path) -> Scene:
    """Read the scene of a run from its results folder."""
    scene = Scene([], [], [], [])
    with (folder / PIXELS_FILE).open('rb') as pixels:
        for text in (folder / SCENE_FILE).read_text(encoding='utf-8').split('\n')[:-1]:
            scene.lines.append(json.loads(text))
            planes = []
            for shape in _shapes(scene.lines[-1]):
                data = pixels.read(4 * math.prod(shape))
                planes.append(np.frombuffer(data, '<f4').reshape(shape) if data else None)
            frame, cells, *statistics = planes
            scene.frames.append(frame)
            scene.cells.append(cells)
            scene.statistics.append({
                name: plane for name, plane in zip(scene.lines[-1].get('chains', {}), statistics)
                if plane is not None})
    return scene
