# SPDX-License-Identifier: Apache-2.0
"""Local maxima against a search through the neighbours of every cell."""

from lowsnr_detect.adaptive.local_maxima import local_maxima
import numpy as np
import pytest


def by_search(plane, reach):
    """Return the cells that exceed all others within the reach, as a dictionary."""
    found = {}
    for row, col in np.ndindex(plane.shape):
        around = plane[max(row - reach, 0):row + reach + 1, max(col - reach, 0):col + reach + 1]
        if plane[row, col] > -np.inf and np.count_nonzero(around >= plane[row, col]) == 1:
            found[row, col] = plane[row, col]
    return found


@pytest.mark.parametrize('shape', [(1, 1), (1, 9), (7, 1), (23, 17), (12, 40)])
@pytest.mark.parametrize('reach', [1, 3, 50])
@pytest.mark.parametrize('levels', [2, 6, 1000])
def test_maxima_are_those_of_a_search(rng, shape, reach, levels):
    # With few levels there are equal neighbours, of which none is a maximum.
    plane = rng.integers(levels, size=shape).astype(np.float32)
    plane[rng.random(shape) < 0.2] = -np.inf
    row, col, value = local_maxima(plane, reach)
    assert list(zip(row.tolist(), col.tolist())) == list(by_search(plane, reach))
    assert np.array_equal(value, plane[row, col])


def test_a_plane_without_values_has_no_maximum():
    row, col, value = local_maxima(np.full((5, 8), -np.inf, np.float32), 2)
    assert len(row) == len(col) == len(value) == 0
