# SPDX-License-Identifier: Apache-2.0
"""Counts of regions, pooled with those around, and quantiles of them, against other methods."""

from lowsnr_detect.adaptive.region_maps import at_cells
from lowsnr_detect.adaptive.region_maps import bin_quantile
from lowsnr_detect.adaptive.region_maps import counted
from lowsnr_detect.adaptive.region_maps import log_odds
from lowsnr_detect.adaptive.region_maps import pooled
import numpy as np
import pytest
import scipy.ndimage


@pytest.mark.parametrize('shape', [(1, 1, 1, 4), (2, 1, 5, 3), (2, 6, 1, 1), (3, 7, 4, 160)])
def test_pooled_counts_are_a_convolution(rng, shape):
    counts = rng.poisson(2.0, shape).astype(float)
    weights = np.outer([0.5, 1.0, 0.5], [0.5, 1.0, 0.5])[None, :, :, None]
    assert pooled(counts) == pytest.approx(
        scipy.ndimage.convolve(counts, weights, mode='constant'))


@pytest.mark.parametrize('part', [0.02, 0.5, 0.8, 1.0])
def test_quantile_of_a_histogram_is_where_its_sum_reaches_the_part(rng, part):
    counts = rng.uniform(0.1, 3.0, (2, 3, 40))
    for found, histogram in zip(bin_quantile(counts, part).ravel(), counts.reshape(-1, 40)):
        summed = np.concatenate([[0.0], np.cumsum(histogram)])
        assert found == pytest.approx(np.interp(part * summed[-1], summed, np.arange(41.0)))


def test_quantile_of_an_empty_histogram_is_in_its_first_bin():
    assert bin_quantile(np.zeros((2, 9)), 0.8).tolist() == [1.0, 1.0]


@pytest.mark.parametrize('grid', [(1, 1), (2, 1), (1, 3), (3, 4)])
def test_values_of_regions_are_linear_between_their_centres(rng, grid):
    rows, cols = shape = (23, 40)
    values = rng.uniform(1.0, 2.0, (2, *grid)).astype(np.float32)
    places = np.meshgrid(
        *((np.arange(size) + 0.5) * count / size - 0.5 for size, count in zip(shape, grid)),
        indexing='ij')
    wanted = np.stack([
        scipy.ndimage.map_coordinates(plane.astype(float), places, order=1, mode='nearest')
        for plane in values])
    index = tuple(each.ravel() for each in np.indices((2, rows, cols)))
    assert at_cells(values, *index, shape) == pytest.approx(wanted.ravel(), rel=1e-5)
    plane = rng.standard_normal(shape).astype(np.float32)
    assert log_odds(plane, *values) == pytest.approx(
        (plane - wanted[0]) / wanted[1], rel=1e-4, abs=1e-5)


def test_places_are_counted_with_their_weights():
    index = np.array([0, 1, 1, 0, 1]), np.array([2, 0, 0, 2, 1])
    assert counted(index, (2, 3)).tolist() == [[0.0, 0.0, 2.0], [2.0, 1.0, 0.0]]
    weight = np.array([True, False, True, True, False])
    assert counted(index, (2, 3), weight).tolist() == [[0.0, 0.0, 2.0], [1.0, 0.0, 0.0]]
