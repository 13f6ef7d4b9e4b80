# SPDX-License-Identifier: Apache-2.0
"""The cells of a tile above the threshold, and the declarations that those of all tiles give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import replace
from typing import Any

from lowsnr_common.core.motion import POS
from lowsnr_detect.parts.cell_detector import CellDetector
from lowsnr_detect.parts.centroids import centroids
from lowsnr_detect.parts.detector import Declarations
from lowsnr_detect.parts.thinning import crossed_cells
from lowsnr_detect.parts.thinning import thinned
from lowsnr_detect.tiles.tile import Tile
import numpy as np


@dataclass(frozen=True)
class Exceedances:
    """
    Cells whose statistic exceeds the threshold, in the coordinates of the frame.

    Parameters
    ----------
    cell : (n, 2) ndarray of int
        Row and column.
    excess : (n,) ndarray
        By how much the statistic exceeds the threshold [nat].
    place : (n, 2) ndarray
        Position x, y that is declared if the cell is [m].
    cov : (n, 2, 2) ndarray
        Covariance of the position [m^2].

    """

    cell: np.ndarray
    excess: np.ndarray
    place: np.ndarray
    cov: np.ndarray

    def __getitem__(self, index: Any) -> Exceedances:
        """Return those that an index picks."""
        return Exceedances(
            self.cell[index], self.excess[index], self.place[index], self.cov[index])


NONE = Exceedances(
    np.empty((0, 2), np.intp), np.empty(0), np.empty((0, 2)), np.empty((0, 2, 2)))


def exceedances_in(
    detector: CellDetector, tile: Tile, state: Any, frame: np.ndarray,
) -> tuple[Any, Exceedances]:
    """
    Advance a detector on a tile by a frame.

    Parameters
    ----------
    detector
        Detector with the threshold of the whole frame.
    tile
        The tile.
    state
        Memory of the detector for frames of the tile's shape.
    frame : (rows, cols) ndarray
        The whole frame.

    Returns
    -------
    state
        Memory after the frame.
    Exceedances
        Those inside the tile; of very many the strongest, which suffice.

    """
    state, plane, row_peaks = detector.tested(state, tile.part_of(frame))
    plane = np.asarray(plane, np.float32)
    flat, excess = crossed_cells(
        plane, detector.threshold, plane.max(axis=-1) if row_peaks is None else row_peaks,
        plane.size)
    cell = np.stack(np.divmod(flat, plane.shape[-1]), axis=-1)
    first = np.array([tile.read_rows[0], tile.read_cols[0]])
    inside = tile.holds(cell + first)
    cell, excess = _strongest(detector, cell[inside], excess[inside])
    shift, cov = _moments(detector, plane, cell)
    place = detector.sensor.cell_size_m * (cell + first)[:, ::-1] + shift
    return state, Exceedances(cell + first, excess, place, cov)


def _strongest(
    detector: CellDetector, cell: np.ndarray, excess: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return at least the cells that can be declared: each suppresses no more than a square."""
    side = 2 * max(detector.suppressed_reach, detector.shadow_reach) + 1
    count = detector.max_detections * side**2
    if excess.size <= count:
        return cell, excess
    kept = excess >= np.partition(excess, -count)[-count]
    return cell[kept], excess[kept]


def _moments(
    detector: CellDetector, plane: np.ndarray, cell: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return how far from its cell (n, 2) of a plane an object is declared, and the covariance."""
    if detector.centroid_reach:
        where = np.zeros(len(cell), np.intp), *cell.T
        return centroids(
            plane[None], where, detector.centroid_reach, detector.sensor.cell_size_m)
    return np.zeros(cell.shape), np.tile(detector.position_std_m**2 * np.eye(2), (len(cell), 1, 1))


def declared(
    detector: CellDetector, parts: Sequence[Exceedances], shape: tuple[int, int],
) -> Declarations:
    """
    Return what a detector declares in a frame (rows, cols) whose tiles have these exceedances.

    Where the exceedances of a tile are missing, nothing is declared there.
    """
    found = Exceedances(*(np.concatenate([getattr(NONE, name), *(
        getattr(part, name) for part in parts)]) for name in ('cell', 'excess', 'place', 'cov')))
    flat = found.cell @ np.array([shape[1], 1])
    order = np.argsort(flat)  # ties are broken as in a whole frame
    flat, found = flat[order], found[order]
    peak = np.array(detector.threshold + found.excess.max(initial=-np.inf))
    made = thinned(
        flat, found.excess, shape, peak, detector.suppressed_reach, detector.max_detections,
        detector.sensor.cell_size_m, detector.position_std_m, detector.shadow_reach)
    used = made.score > 0.0
    col, row = np.rint(made.state[used][:, POS].T / detector.sensor.cell_size_m).astype(np.intp)
    chosen = found[np.searchsorted(flat, row * shape[1] + col)]
    state, cov = made.state.copy(), made.cov.copy()
    slot = np.flatnonzero(used)
    state[slot[:, None], POS] = chosen.place
    cov[slot[:, None, None], np.array(POS)[:, None], POS] = chosen.cov
    return replace(made, state=state, cov=cov)
