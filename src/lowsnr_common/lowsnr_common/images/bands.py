# SPDX-License-Identifier: Apache-2.0
"""Sub-regions of a frame, processed in parallel as Section IV-A suggests."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
import functools

import numpy as np


def in_bands(work: Callable[[int, int], None], rows: int, count: int, multiple: int = 1) -> None:
    """
    Call a function for bands of rows in parallel threads; the result is that of one call.

    Parameters
    ----------
    work
        Writes the rows from its first argument to before its second.  It may read all rows.
    rows
        Rows of the frame.
    count
        Number of bands.  Threads suffice: compiled loops release the interpreter's lock.
    multiple
        Bands begin at multiples of so many rows.

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
    """Return the threads for a number of bands, started once: a start costs more than a band."""
    return ThreadPoolExecutor(count, thread_name_prefix='regions')
