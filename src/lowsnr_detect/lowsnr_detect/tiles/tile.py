# SPDX-License-Identifier: Apache-2.0
"""The tiles of a frame, and which detectors can be divided into them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from itertools import product

from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_common.settings.node_settings import TileSettings
from lowsnr_detect.parts.cell_detector import CellDetector
from lowsnr_detect.parts.detector import Detector
import numpy as np


@dataclass(frozen=True)
class Tile:
    """
    A part of a frame that one node answers.

    Parameters
    ----------
    rows, cols
        First and one past the last of the cells whose declarations are those of the tile.
    read_rows, read_cols
        The same of the cells that it reads: the tile and its halo, within the frame.

    """

    rows: tuple[int, int]
    cols: tuple[int, int]
    read_rows: tuple[int, int]
    read_cols: tuple[int, int]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns that are read."""
        return self.read_rows[1] - self.read_rows[0], self.read_cols[1] - self.read_cols[0]

    def part_of(self, frame: np.ndarray) -> np.ndarray:
        """Return what the tile reads of a frame (rows, cols)."""
        return np.ascontiguousarray(frame[slice(*self.read_rows), slice(*self.read_cols)])

    def holds(self, cells: np.ndarray) -> np.ndarray:
        """Return which cells (n, 2), rows and columns of the frame, are in the tile, (n,)."""
        row, col = cells.T
        return np.asarray((self.rows[0] <= row) & (row < self.rows[1])
                          & (self.cols[0] <= col) & (col < self.cols[1]))


def divisible(detector: Detector, operating: DetectionSettings) -> CellDetector:
    """
    Return a detector that can be divided into tiles.

    Raises
    ------
    ValueError
        If its statistic is not one of cells near by, its thresholds are adaptive, or its
        statistic is to be published.

    """
    name = type(detector).__name__
    if not isinstance(detector, CellDetector):
        raise ValueError(
            f'{name} cannot be divided into tiles: its posterior is that of the whole frame; use '
            'cdt, sdt, cusum, bank or auto')
    if detector.halo is None:
        raise ValueError(
            f'{name} cannot be divided into tiles with these settings: it has no halo; sdt has '
            'one with restart all and destination.probability 0')
    if operating.operating_point == 'adaptive':
        raise ValueError(
            f'{name} cannot be divided into tiles with adaptive thresholds, which the whole frame '
            'teaches; set operating_point to matched, nominal or manual')
    if operating.statistic_map:
        raise ValueError(f'{name} in tiles does not publish statistic; set statistic_map to false')
    return detector


def tiles_of(
    detector: CellDetector, shape: tuple[int, int], tiling: TileSettings,
) -> list[Tile]:
    """
    Return the tiles of a frame (rows, cols), row by row, with the halo of a detector.

    Raises
    ------
    ValueError
        If there are more tiles than cells along an axis, or the size of frames is not known.

    """
    halo = (detector.halo or 0) + detector.centroid_reach
    spans = []
    for cells, count, name in zip(
            shape, (tiling.tiles_down, tiling.tiles_across), ('rows', 'columns'), strict=True):
        if not 0 < count <= cells:
            raise ValueError(
                f'{count} tiles cannot divide the {cells} {name} of a frame: set 1 to {cells}'
                if cells > 0 else
                f'the {name} of a frame are not known: set rows and cols')
        edges = np.linspace(0, cells, count + 1).astype(int).tolist()
        spans.append([
            ((first, last), (max(first - halo, 0), min(last + halo, cells)))
            for first, last in pairwise(edges)])
    return [Tile(rows, cols, read_rows, read_cols)
            for (rows, read_rows), (cols, read_cols) in product(*spans)]
