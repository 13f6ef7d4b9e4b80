# SPDX-License-Identifier: Apache-2.0
"""The map of a conditioned frame: cells, scene and image, by hand and back."""

from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.frame_map import moved_states
from lowsnr_common.core.frame_map import overlaps
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Prediction
import numpy as np
import pytest

SHIFTED = FrameMap('camera', (60, 40), 2, (8, 4), (-17.25, -6.5))


@pytest.mark.parametrize(('where', 'cell', 'pixel'), [
    (FrameMap('camera', (60, 40), 1), (3.0, 2.25), (3.0, 2.25)),
    # The centre of the 2 x 2 pixels 6, 7 and 4, 5.
    (FrameMap('camera', (60, 40), 2), (3.0, 2.0), (6.5, 4.5)),
    # Cell (9, 6) of the scene, whose centre is at 18.5, 12.5.
    (SHIFTED, (1.0, 2.0), (1.25, 6.0)),
])
def test_cell_lies_at_the_centre_of_its_pixels(where, cell, pixel):
    assert where.pixels(np.array(cell)).tolist() == list(pixel)
    assert where.cells(np.array(pixel)).tolist() == list(cell)


@pytest.mark.parametrize('binning', [1, 2])
def test_object_keeps_its_meaning_there_and_back(rng, binning):
    where = FrameMap('camera', (60, 40), binning, (-12, 4), (20.3, -7.7))
    root = rng.standard_normal((4, 4))
    predicted = Prediction(0.4, rng.normal(5.0, 3.0, 2), root[:2, :2] @ root[:2, :2].T)
    item = Estimate(rng.normal(5.0, 3.0, 4), root @ root.T, 0.75, '7', predicted)
    seen = where.in_image(item, 3.0)
    np.testing.assert_allclose(
        seen.state[[0, 2]] / 3.0, where.pixels(item.state[[0, 2]] / 3.0), rtol=1e-12)
    np.testing.assert_allclose(seen.state[[1, 3]], binning * item.state[[1, 3]], rtol=1e-12)
    np.testing.assert_allclose(np.sqrt(np.diag(seen.cov)), binning * np.sqrt(np.diag(item.cov)))
    np.testing.assert_allclose(
        seen.predicted.position, 3.0 * where.pixels(predicted.position / 3.0), rtol=1e-12)
    np.testing.assert_allclose(seen.predicted.cov, binning**2 * predicted.cov)
    back = where.in_cells(seen, 3.0)
    np.testing.assert_allclose(back.predicted.position, predicted.position, rtol=1e-12)
    np.testing.assert_allclose(back.predicted.cov, predicted.cov, rtol=1e-12)
    assert back.predicted.score == 0.4
    np.testing.assert_allclose(back.state, item.state, rtol=1e-12)
    np.testing.assert_allclose(back.cov, item.cov, rtol=1e-12)
    assert (back.score, back.id) == (seen.score, seen.id) == (0.75, '7')


def test_states_move_against_the_cells():
    later = FrameMap('camera', (60, 40), 2, (12, -4), (-25.0, 3.0))
    by = later.moved_since(SHIFTED)
    assert by == (-8, 4)
    assert later.moved_since(None) == (0, 0)
    states = np.array([[30.0, 1.0, 20.0, -2.0]])
    moved = moved_states(states, by, 2.0)
    assert moved.tolist() == [[22.0, 1.0, 36.0, -2.0]]
    # The place in the scene is the same.
    np.testing.assert_array_equal(
        moved[0, [0, 2]] / 2.0 + later.origin, states[0, [0, 2]] / 2.0 + SHIFTED.origin)


@pytest.mark.parametrize(('by', 'expected'), [
    ((0, 0), True), ((19, -29), True), ((20, 0), False), ((0, -30), False)])
def test_cells_overlap_unless_they_moved_by_a_whole_frame(by, expected):
    assert overlaps(by, (20, 30)) == expected
