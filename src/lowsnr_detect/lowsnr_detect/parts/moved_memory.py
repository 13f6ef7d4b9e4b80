# SPDX-License-Identifier: Apache-2.0
"""The memory of a detector when its cells move over the scene, because the camera did."""

from __future__ import annotations

from dataclasses import fields
from dataclasses import is_dataclass
from dataclasses import replace
from typing import Any
from typing import Protocol
from typing import runtime_checkable

from lowsnr_detect.parts.moves import shifted
import numpy as np


@runtime_checkable
class Movable(Protocol):
    """A memory that is more than planes of cells, and moves them itself."""

    def moved(self, by: tuple[int, int], cell_size_m: float) -> Any:
        """Return the memory for cells that begin ``by`` rows and columns further on."""
        ...


def moved_memory(
    memory: Any, fresh: Any, shape: tuple[int, int], by: tuple[int, int], cell_size_m: float,
) -> Any:
    """
    Return a memory for cells whose first one moved in the scene.

    Parameters
    ----------
    memory
        Memory of a detector: planes (..., rows, cols), what is :class:`Movable`, what does not
        depend on the place, and tuples and dataclasses of these.
    fresh
        The memory before the first frame: cells that come into view begin with it, and with 0
        where it does not hold the plane yet.
    shape
        Rows and columns.
    by
        Rows and columns by which the first cell moved.
    cell_size_m
        Side of a cell [m].

    """
    if isinstance(memory, Movable):
        return memory.moved(by, cell_size_m)
    if isinstance(memory, np.ndarray):
        if memory.shape[-2:] != shape:
            return memory
        moved = shifted(memory, np.negative(by), 0)
        if isinstance(fresh, np.ndarray):
            enters = shifted(np.zeros(shape, dtype=bool), np.negative(by), True)
            moved[..., enters] = fresh[..., enters]
        return moved
    if isinstance(memory, tuple):
        same = isinstance(fresh, tuple) and len(fresh) == len(memory)
        return tuple(
            moved_memory(each, fresh[n] if same else None, shape, by, cell_size_m)
            for n, each in enumerate(memory))
    if is_dataclass(memory) and not isinstance(memory, type):
        return replace(memory, **{
            item.name: moved_memory(
                getattr(memory, item.name), getattr(fresh, item.name, None), shape, by,
                cell_size_m)
            for item in fields(memory)})
    return memory
