"""Sub-regions of a frame, worked on in parallel as Section IV-A suggests, to the same result."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
import functools

import numpy as np

_ROWS = -2


def by_regions(
    function: Callable[..., np.ndarray], planes: tuple[np.ndarray, ...], count: int, margin: int,
) -> np.ndarray:
    """
    Apply a function to bands of rows in parallel threads and put the results together.

    Each band is handed over with ``margin`` rows more on either side, so that a function whose
    result depends on cells no further away gives the very numbers it gives for whole planes.

    Parameters
    ----------
    function
        Takes the planes of a band and returns an array (..., rows, cols) of the same rows.
    planes : tuple of (..., rows, cols) ndarrays
        What the function works on.
    count
        Number of bands; NumPy works without the interpreter's lock, so threads do.
    margin
        Rows that a band needs on either side.

    Returns
    -------
    (..., rows, cols) ndarray
        The result for the whole planes.

    """
    rows = planes[0].shape[_ROWS]
    count = min(count, rows)
    if count <= 1:
        return function(*planes)
    edges = np.linspace(0, rows, count + 1).astype(int)

    def work(start: int, stop: int) -> np.ndarray:
        first, last = max(0, start - margin), min(rows, stop + margin)
        result = function(*(plane[..., first:last, :] for plane in planes))
        return result[..., start - first:stop - first, :]

    return np.concatenate(list(_threads(count).map(work, edges[:-1], edges[1:])), axis=_ROWS)


@functools.cache
def _threads(count: int) -> ThreadPoolExecutor:
    """Return the threads that are kept for a number of bands: starting them costs more."""
    return ThreadPoolExecutor(count, thread_name_prefix='regions')
