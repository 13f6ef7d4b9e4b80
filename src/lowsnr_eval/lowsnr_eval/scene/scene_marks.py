# SPDX-License-Identifier: Apache-2.0
"""Objects, detections and tracks of a frame as lists of numbers, for pages that draw them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from lowsnr_common.core.motion import POS
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Truth
import numpy as np


def marks(
    items: Sequence[Truth] | Sequence[Estimate] | None, cell_size_m: float,
) -> list[list[Any]] | None:
    """Return column, row and id of each item with a position; None of unknown items."""
    if items is None:
        return None
    found = [(*(item.state[POS] / cell_size_m).tolist(), item.id) for item in items]
    return [[round(x, 3), round(y, 3), name] for x, y, name in found
            if np.isfinite(x) and np.isfinite(y)]


def track_marks(
    tracks: Sequence[Estimate] | None, cell_size_m: float,
) -> list[list[Any]] | None:
    """
    Return marks of tracks, each with existence probability and covariance.

    The covariance is that of column and row [cells^2]: xx, xy, yy.  A value that is not finite
    is None.
    """
    if tracks is None:
        return None
    found = []
    for item in tracks:
        cov = item.cov[np.ix_(POS, POS)] / cell_size_m**2
        values = (item.score, cov[0, 0], cov[0, 1], cov[1, 1])
        found += [[*mark, *(round(float(each), 4) if np.isfinite(each) else None
                            for each in values)]
                  for mark in marks([item], cell_size_m) or ()]
    return found
