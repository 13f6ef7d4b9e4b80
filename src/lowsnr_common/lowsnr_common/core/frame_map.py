# SPDX-License-Identifier: Apache-2.0
"""Where the cells of a conditioned frame lie in the scene, and the scene in the camera's image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Prediction
import numpy as np


@dataclass(frozen=True)
class FrameMap:
    """
    The map of one frame, from cells to the scene and on to the pixels of the image.

    The scene stands still while the camera moves; after a cut the new one lies where no earlier
    image reached.  Cells have ``binning`` pixels along each side.  Along each axis ::

        pixel in the scene = binning * (cell + origin) + (binning - 1) / 2
        pixel in the image = pixel in the scene + to_image

    Positions in metres are in units of ``cell_size_m``, which is the side of a pixel where a
    position is one of the image, and that of a cell otherwise.

    Parameters
    ----------
    frame_id
        Name of the coordinates of the image.
    size
        Columns and rows of the image.
    binning
        Pixels along each side of a cell.
    origin
        Place x, y of the first cell in the scene [cells].
    to_image
        Motion of the image with respect to the scene, x, y [pixels].

    """

    frame_id: str
    size: tuple[int, int]
    binning: int
    origin: tuple[int, int] = (0, 0)
    to_image: tuple[float, float] = (0.0, 0.0)

    def pixels(self, cells: np.ndarray) -> np.ndarray:
        """Return positions x, y of cells in pixels of the image, (..., 2)."""
        return np.asarray(self.binning * (cells + np.array(self.origin)) + self._shift)

    def cells(self, pixels: np.ndarray) -> np.ndarray:
        """Return positions x, y in pixels of the image in cells, (..., 2)."""
        return np.asarray((pixels - self._shift) / self.binning - self.origin)

    def in_image(self, item: Estimate, cell_size_m: float) -> Estimate:
        """Return an object that is given in cells in pixels; its velocity stays in the scene."""
        return _mapped(
            item, lambda place: cell_size_m * self.pixels(place / cell_size_m), self.binning)

    def in_cells(self, item: Estimate, cell_size_m: float) -> Estimate:
        """Return an object that is given in pixels in cells; its velocity stays in the scene."""
        return _mapped(
            item, lambda place: cell_size_m * self.cells(place / cell_size_m),
            1.0 / self.binning)

    def moved_since(self, before: FrameMap | None) -> tuple[int, int]:
        """Return rows and columns by which the first cell moved in the scene."""
        x, y = np.subtract(self.origin, before.origin if before else self.origin).tolist()
        return y, x

    @property
    def _shift(self) -> np.ndarray:
        """Place x, y of the cell (0, 0) of the scene in the image [pixels]."""
        return (self.binning - 1) / 2.0 + np.array(self.to_image)


def moved_states(states: np.ndarray, by: tuple[int, int], cell_size_m: float) -> np.ndarray:
    """Return states (..., 4) in cells whose first one moved ``by`` rows and columns."""
    moved = states.copy()
    moved[..., POS] -= np.multiply(by[::-1], cell_size_m)
    return moved


def overlaps(by: tuple[int, int], shape: tuple[int, int]) -> bool:
    """Return whether cells that moved ``by`` rows and columns still cover some of the same."""
    return all(abs(step) < size for step, size in zip(by, shape, strict=True))


def _mapped(
    item: Estimate, place: Callable[[np.ndarray], np.ndarray], factor: float,
) -> Estimate:
    """Return an object elsewhere, its velocity and errors larger by a factor."""
    state, predicted = item.state.copy(), item.predicted
    state[POS] = place(item.state[POS])
    state[VEL] *= factor
    if predicted is not None:
        predicted = Prediction(
            predicted.score, place(predicted.position), predicted.cov * factor**2)
    return Estimate(state, item.cov * factor**2, item.score, item.id, predicted)
