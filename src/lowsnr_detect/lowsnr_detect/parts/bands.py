"""Sub-regions of a frame, worked on in parallel as Section IV-A suggests, to the same result."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
import functools

import numpy as np


def in_bands(work: Callable[[int, int], None], rows: int, count: int, multiple: int = 1) -> None:
    """
    Let parallel threads write a band of rows each.

    Parameters
    ----------
    work
        Writes the rows from the first to before the last; it reads what it likes.
    rows
        Rows of the frame.
    count
        Number of bands; the compiled loops run without the interpreter's lock, so threads do.
    multiple
        Rows that stay together.

    """
    groups = -(-rows // multiple)
    count = min(count, groups)
    if count <= 1:
        work(0, rows)
        return
    edges = np.minimum(np.linspace(0, groups, count + 1).astype(int) * multiple, rows)
    list(_threads(count).map(work, edges[:-1].tolist(), edges[1:].tolist()))


@functools.cache
def _threads(count: int) -> ThreadPoolExecutor:
    """Return the threads that are kept for a number of bands: starting them costs more."""
    return ThreadPoolExecutor(count, thread_name_prefix='regions')
