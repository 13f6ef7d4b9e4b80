# SPDX-License-Identifier: Apache-2.0
"""The overlay, against pixels and points worked out by hand."""

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.records import Estimate
from lowsnr_common.settings.node_settings import ViewSettings
from lowsnr_eval.report.overlay import draw
from lowsnr_eval.report.overlay import ellipse
from lowsnr_eval.report.overlay import Scene
from lowsnr_eval.report.overlay import Trails
from lowsnr_eval.report.palette import DETECTION
from lowsnr_eval.report.palette import rgb
from lowsnr_eval.report.palette import stretch
from lowsnr_eval.report.palette import TRACK
from lowsnr_eval.report.palette import TRUTH
import numpy as np
import pytest

ROWS, COLS, ZOOM = 7, 5, 40
SETTINGS = ViewSettings(side=ROWS * ZOOM)
GREY = np.full((ROWS, COLS), 100, dtype=np.uint8)


def estimate(x, y, cov=None, name='', score=0.5, velocity=(0.0, 0.0)):
    full = np.zeros((4, 4))
    if cov is not None:
        full[np.ix_([0, 2], [0, 2])] = cov
    return Estimate(np.array([x, velocity[0], y, velocity[1]]), full, score, name)


def coloured(picture, colour):
    """Return (x, y) in cells of the pixels that have a colour."""
    rows, cols = np.nonzero((picture == rgb(colour)).all(axis=-1))
    return (np.stack([cols, rows], axis=-1) + 0.5) / ZOOM - 0.5


def test_stretch_of_a_known_frame():
    # 1 % and 99.9 % of 0 ... 1000 are 10 and 999.
    frame = np.arange(1001.0).reshape(7, 143)
    greys = stretch(frame)
    assert greys.dtype == np.uint8
    assert greys.shape == frame.shape
    assert np.array_equal(greys, np.clip((frame - 10.0) * 255.0 / 989.0, 0, 255).astype(np.uint8))


def test_one_bright_cell_leaves_the_greys_of_the_others(rng):
    frame = rng.standard_normal((100, 100))
    frame[3, 4] = 1e9
    greys = stretch(frame)
    assert greys[3, 4] == 255
    assert 60 < np.median(greys) < 160


def test_cells_without_a_value_are_black_and_change_no_other(rng):
    frame = rng.standard_normal((100, 101))
    whole = stretch(frame[:, :100])
    frame[:, 100] = np.nan
    np.testing.assert_array_equal(stretch(frame)[:, 100], 0)
    assert abs(stretch(frame)[:, :100].astype(int) - whole).max() <= 1


@pytest.mark.parametrize('value', [0.0, -3.0, 1e30, np.nan])
def test_frame_of_a_constant_is_black(value):
    assert not stretch(np.full((7, 5), value)).any()


def test_cells_become_squares_of_their_grey(rng):
    greys = rng.integers(0, 256, (ROWS, COLS), dtype=np.uint8)
    picture = draw(greys, Scene(), SETTINGS)
    assert picture.shape == (ROWS * ZOOM, COLS * ZOOM, 3)
    for row in range(ROWS):
        for col in range(COLS):
            cell = picture[row * ZOOM:(row + 1) * ZOOM, col * ZOOM:(col + 1) * ZOOM]
            assert (cell == greys[row, col]).all()


@pytest.mark.parametrize(('shape', 'expected'), [
    ((20, 20), (480, 480, 3)), ((256, 320), (512, 640, 3)), ((1024, 768), (1024, 768, 3))])
def test_longer_side_of_an_overlay_has_the_least_length(shape, expected):
    picture = draw(np.zeros(shape, dtype=np.uint8), Scene(), ViewSettings())
    assert picture.shape == expected


def test_truth_is_a_circle_around_its_position():
    places = coloured(draw(GREY, Scene(truth=[estimate(3.0, 2.0)]), SETTINGS), TRUTH)
    # 1.5 times a mark's reach, which is 0.6 cells.
    assert np.hypot(*(places - (3.0, 2.0)).T) == pytest.approx(0.9, abs=0.06)
    assert len(places) > 2 * np.pi * 0.9 * ZOOM


def test_detection_is_a_square_around_its_position():
    places = coloured(draw(GREY, Scene(detections=[estimate(1.0, 4.0)]), SETTINGS), DETECTION)
    assert np.abs(places - (1.0, 4.0)).max(axis=1) == pytest.approx(0.6, abs=0.06)


def test_positions_in_metres_are_drawn_in_their_cells():
    settings = ViewSettings(side=ROWS * ZOOM, sensor=SensorModel(cell_size_m=0.5))
    places = coloured(draw(GREY, Scene(truth=[estimate(1.5, 1.0)]), settings), TRUTH)
    assert places.mean(axis=0) == pytest.approx([3.0, 2.0], abs=0.02)


def test_ellipse_lies_where_the_covariance_says():
    # Half axes 2 x sqrt(1) = 2 and 2 x sqrt(0.25) = 1 cells, along and across the diagonal.
    turn = np.array([[1.0, -1.0], [1.0, 1.0]]) / np.sqrt(2.0)
    cov = turn @ np.diag([0.64, 0.16]) @ turn.T
    track = estimate(2.0, 3.0, cov)
    offsets = ellipse(track, 2.0) - (2.0, 3.0)
    assert np.einsum('ni,ij,nj->n', offsets, np.linalg.inv(cov), offsets) == pytest.approx(4.0)
    picture = draw(GREY, Scene(tracks=[track]), SETTINGS)
    along, across = np.array([1.0, 1.0]) / np.sqrt(2.0), np.array([1.0, -1.0]) / np.sqrt(2.0)

    def pixel(place):
        col, row = ((np.array(place) + 0.5) * ZOOM - 0.5).round().astype(int)
        return tuple(picture[row, col])

    for direction, half in ((along, 1.6), (across, 0.8)):
        for side in (-half, half):
            assert pixel((2.0, 3.0) + side * direction) == rgb(TRACK)
            assert pixel((2.0, 3.0) + 1.15 * side * direction) == (100, 100, 100)


def test_stroke_of_a_track_ends_at_its_predicted_position():
    settings = ViewSettings(side=ROWS * ZOOM, sensor=SensorModel(frame_period_s=0.5))
    track = estimate(1.0, 5.0, velocity=(4.0, -6.0))
    picture = draw(GREY, Scene(tracks=[track]), settings)
    places = coloured(picture, TRACK)
    assert np.hypot(*(places - (3.0, 2.0)).T).min() < 0.05
    assert np.hypot(*(places - (2.0, 3.5)).T).min() < 0.05
    assert not (np.hypot(*(places - (3.4, 1.4)).T) < 0.2).any()


def test_trail_goes_through_the_past():
    trails = Trails(10)
    trails.add([estimate(0.0, 1.0, name='1')])
    trails.add([estimate(2.0, 1.0, name='1')])
    past = trails.add([estimate(2.0, 5.0, name='1', score=0.9)])
    assert past['1'].tolist() == [
        [2.0, 0.0, 1.0, 0.5], [1.0, 2.0, 1.0, 0.5], [0.0, 2.0, 5.0, 0.9]]
    places = coloured(draw(GREY, Scene(trails=past), SETTINGS), TRACK)
    for x, y in ((1.0, 1.0), (2.0, 3.0)):
        assert np.hypot(*(places - (x, y)).T).min() < 0.05
    assert ((np.abs(places[:, 1] - 1.0) < 0.06) | (np.abs(places[:, 0] - 2.0) < 0.06)).all()


def test_trails_end_after_the_given_frames():
    trails = Trails(3)
    for k in range(1000):
        past = trails.add([estimate(0.0, 0.0, name=str(k))])
    assert sorted(past) == ['997', '998', '999']
    assert len(trails.add([])) == 2
    assert len(trails.add([])) == 1
    assert trails.add([]) == {}


def test_estimate_without_position_or_covariance_is_left_out():
    unknown = Estimate(np.full(4, np.nan), np.full((4, 4), np.nan), 0.5, 'nowhere')
    nothing = Scene([unknown], [unknown], [unknown], {'1': np.full((2, 4), np.nan)})
    assert (draw(GREY, nothing, SETTINGS) == 100).all()
    assert np.isnan(ellipse(unknown, 2.0)).all()
    placed = Estimate(np.array([2.0, np.nan, 3.0, np.nan]), np.full((4, 4), np.nan), 0.5, '1')
    assert len(coloured(draw(GREY, Scene(tracks=[placed]), SETTINGS), TRACK)) > 50


def test_estimate_far_outside_the_frame_changes_no_pixel():
    far = [estimate(1e300, -1e300, 1e300 * np.eye(2), 'far', velocity=(1e300, 0.0))]
    assert (draw(GREY, Scene(far, far, (), {}), SETTINGS) == 100).all()
    assert draw(GREY, Scene(tracks=far), SETTINGS).shape == (ROWS * ZOOM, COLS * ZOOM, 3)


def test_singular_covariance_is_drawn_as_a_line():
    # An eigenvalue below 0, as rounding leaves it, is 0.
    points = ellipse(estimate(1.0, 1.0, np.diag([1.0, -1e-9])), 2.0)
    assert points[:, 0].max() == pytest.approx(3.0)
    assert points[:, 1] == pytest.approx(1.0)
