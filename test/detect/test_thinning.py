# SPDX-License-Identifier: Apache-2.0
"""Thinning: the declarations equal a search that looks at every cell again for each of them."""

from lowsnr_common.core.motion import POS
from lowsnr_detect.parts.thinning import declare_cells
import numpy as np
import pytest
from scipy.ndimage import uniform_filter

THRESHOLD = -0.5
SIZES = {'cell_size_m': 1.0, 'position_std_m': 0.3}


def greedy(plane, reach, shadow_reach, most):
    """Return the declared cells (row, col) of a plane, strongest first, by brute force."""
    excess = {cell: value - THRESHOLD for cell, value in np.ndenumerate(plane.astype(float))
              if value > THRESHOLD}
    declared = []
    while excess and len(declared) < most:
        best = max(excess, key=lambda cell: (excess[cell], -cell[0], -cell[1]))
        strongest = excess[best]
        declared.append(best)
        for cell in list(excess):
            distance = max(abs(cell[0] - best[0]), abs(cell[1] - best[1]))
            weak = excess[cell] < 0.25 * strongest
            if distance <= (max(reach, shadow_reach) if weak else reach):
                del excess[cell]
    return declared


@pytest.mark.parametrize('ties', [False, True])
@pytest.mark.parametrize(('reach', 'shadow_reach', 'most'), [
    (0, 0, 5), (1, 0, 4), (1, 3, 2), (2, 1, 3), (0, 2, 1)])
def test_many_crossed_cells_are_thinned_as_by_brute_force(reach, shadow_reach, most, ties):
    noise = np.random.default_rng(0).normal(size=(6, 23, 31))
    planes = uniform_filter(noise, (1, 5, 5)).astype(np.float32) * 5.0  # strong cells are close
    if ties:
        planes = np.round(2.0 * planes) / 2.0
    planes[2] = THRESHOLD  # nothing crosses it, between planes where much does
    planes[4, 3:] = THRESHOLD
    found = declare_cells(
        planes, THRESHOLD, reach=reach, most=most, shadow_reach=shadow_reach, **SIZES)
    for plane, score, state in zip(planes, found.score, found.state, strict=True):
        wanted = greedy(plane, reach, shadow_reach, most)
        assert np.count_nonzero(score) == len(wanted)
        np.testing.assert_array_equal(
            state[:len(wanted), POS], np.reshape(wanted, (-1, 2))[:, ::-1])
