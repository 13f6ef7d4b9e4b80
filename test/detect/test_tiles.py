# SPDX-License-Identifier: Apache-2.0
"""A detector in tiles declares what one detector of the whole frame declares."""

from dataclasses import replace

from lowsnr_common.core.destination import Destination
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_common.settings.node_settings import TileSettings
from lowsnr_detect.parts.cell_detector import CellDetector
from lowsnr_detect.parts.registry import detector_class
from lowsnr_detect.tiles.exceedances import declared
from lowsnr_detect.tiles.exceedances import exceedances_in
from lowsnr_detect.tiles.tile import divisible
from lowsnr_detect.tiles.tile import tiles_of
import numpy as np
import pytest

SHAPE = (30, 44)
GRID = TileSettings(tiles_down=2, tiles_across=3)
NOMINAL = DetectionSettings(operating_point='nominal')
# Thresholds that a few cells of each frame exceed.
LOCAL = {
    'cdt': {'threshold': 3.0}, 'cdt blurred': {'threshold': 3.0},
    'sdt': {'threshold': 5.0, 'upper_threshold': 7.0},
    'sdt blurred': {'threshold': 5.0}, 'sdt far': {'threshold': 7.0, 'radius': 2},
    'sdt with prior': {'threshold': -2.0, 'move_prior': True, 'max_iterations': 4}}
REMEMBERING = {'cusum': {'threshold': 6.0}, 'bank': {'threshold': 6.0}, 'auto': {'threshold': 6.0}}


def build(name, values, snr_db=9.0):
    """Return a detector; one whose name says so has blur."""
    sensor = SensorModel(snr_db=snr_db, blur_m=0.7 * ('blurred' in name))
    return detector_class(name.split()[0])(sensor=sensor, **values)


def frames(sensor, count, shape, seed):
    """Yield frames of noise with objects that cross the whole frame, also along its diagonal."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(size=(4, 2)) * shape
    speed = np.array([[0.9, 0.9], [0.0, 1.0], [-0.7, 0.4], [0.1, -0.2]])
    for _ in range(count):
        place = (place + speed) % shape
        frame = sensor.noise_std * rng.standard_normal(shape)
        for row, col in place.astype(int):
            frame[row, col] += 2.0 * sensor.intensity
        yield frame


def compare(detector, tiles, count, shape=SHAPE, seed=1):
    """Return the declarations of the whole frames, and of their tiles, as lists of estimates."""
    rng, whole = np.random.default_rng(0), detector.init(shape)
    parts, found = [detector.init(tile.shape) for tile in tiles], []
    for frame in frames(detector.sensor, count, shape, seed):
        whole, at_once = detector.step(whole, frame, rng)
        made = [exceedances_in(detector, *each, frame) for each in zip(tiles, parts, strict=True)]
        parts, exceedances = zip(*made, strict=True)
        found.append((at_once.estimates(), declared(detector, exceedances, shape).estimates()))
    return found


def check_same(found, least, within=1e-12):
    """Check that both declare the same in each frame, and more than so many in all."""
    assert sum(len(whole) for whole, _ in found) > least
    for whole, tiled in found:
        for one, other in zip(whole, tiled, strict=True):
            assert other.score == pytest.approx(one.score, abs=within)
            np.testing.assert_allclose(other.state, one.state, rtol=0, atol=within)
            np.testing.assert_allclose(other.cov, one.cov, rtol=0, atol=within)


@pytest.mark.parametrize('name', LOCAL)
def test_tiles_of_a_local_detector_declare_the_same(name):
    detector = build(name, LOCAL[name])
    tiles = tiles_of(detector, SHAPE, GRID)
    assert len(tiles) == 6
    assert all(tile.shape != SHAPE for tile in tiles)
    check_same(compare(detector, tiles, 40), 100)


@pytest.mark.parametrize('name', REMEMBERING)
def test_tiles_of_a_detector_that_remembers_long_declare_the_same_within_their_halo(name):
    detector = build(name, REMEMBERING[name])
    shape = (8, 2 * detector.halo + 24)
    tiles = tiles_of(detector, shape, TileSettings(tiles_down=1, tiles_across=2))
    assert all(tile.shape[1] < shape[1] for tile in tiles)
    # What lies beyond the halo changes a sum of the bank by less than 1e-3.
    check_same(compare(detector, tiles, 150, shape), 200, 1e-12 if name == 'cusum' else 1e-3)


def test_halo_of_sdt_is_the_least_that_holds_the_longest_path():
    detector = build('sdt', {'threshold': 20.0, 'max_iterations': 5})
    assert detector.halo == 4
    tile = tiles_of(detector, SHAPE, TileSettings(tiles_down=1, tiles_across=2))[1]
    first, short = tile.cols[0], replace(tile, read_cols=(tile.read_cols[0] + 1, SHAPE[1]))
    peaks = []
    for each in (tile, short):
        state = detector.init(each.shape)
        for step in range(5):  # an object that comes from the other tile, a cell a frame
            frame = np.zeros(SHAPE)
            frame[10, first - 4 + step] = 2.0 * detector.sensor.intensity
            state, found = exceedances_in(detector, each, state, frame)
        peaks.append(found.excess.max(initial=0.0))
    # Each of five frames adds (I / sigma^2) (2 I - I / 2), of which the short halo lacks one.
    one = 1.5 * detector.sensor.intensity**2 / detector.sensor.noise_std**2
    assert peaks[0] == pytest.approx(5 * one - 20.0, rel=1e-5)
    assert peaks[1] < peaks[0] - one / 2


def test_cells_at_a_seam_are_thinned_together():
    detector = build('cdt', {'threshold': 1.0, 'thinning_reach': 1})
    tiles = tiles_of(detector, SHAPE, TileSettings(tiles_down=1, tiles_across=2))
    seam, frame = tiles[0].cols[1], np.zeros(SHAPE)
    # The strongest suppresses its neighbour beyond the seam, which would suppress the third.
    frame[5, seam - 1:seam + 2] = np.array([9.0, 8.0, 7.0]) * detector.sensor.noise_std
    found = [exceedances_in(detector, tile, None, frame)[1] for tile in tiles]
    assert [len(part.excess) for part in found] == [1, 2]
    made = declared(detector, found, SHAPE).estimates()
    assert [tuple(item.state[[0, 2]]) for item in made] == [(seam - 1, 5), (seam + 1, 5)]


def test_missing_tile_lacks_only_what_is_in_it():
    detector = build('cdt', {'threshold': 1.0})
    tiles, frame = tiles_of(detector, SHAPE, GRID), np.zeros(SHAPE)
    frame[3, 3] = frame[28, 40] = 9.0 * detector.sensor.noise_std
    found = [exceedances_in(detector, tile, None, frame)[1] for tile in tiles]
    assert len(declared(detector, found, SHAPE).estimates()) == 2
    only, = declared(detector, found[:-1], SHAPE).estimates()
    assert tuple(only.state[[0, 2]]) == (3.0, 3.0)
    assert declared(detector, [], SHAPE).estimates() == []


def test_more_exceedances_than_suffice_are_left_out_and_the_declarations_stay():
    detector = build('cdt', {'threshold': -50.0, 'max_detections': 3, 'thinning_reach': 1})
    tiles = tiles_of(detector, SHAPE, GRID)
    frame = np.random.default_rng(4).standard_normal(SHAPE)
    found = [exceedances_in(detector, tile, None, frame)[1] for tile in tiles]
    assert {len(part.excess) for part in found} == {3 * 3**2}
    check_same([(detector.step(None, frame, None)[1].estimates(),
                 declared(detector, found, SHAPE).estimates())], 2)


def test_every_cell_is_in_one_tile():
    tiles = tiles_of(build('cdt', {}), SHAPE, GRID)
    cells = np.stack(np.indices(SHAPE), axis=-1).reshape(-1, 2)
    assert (sum(tile.holds(cells).astype(int) for tile in tiles) == 1).all()


class Unknown(CellDetector):
    """A detector of which nobody has said what a cell depends on."""


@pytest.mark.parametrize(('detector', 'operating', 'words'), [
    (detector_class('hmm')(), {}, 'posterior'), (detector_class('tbd1')(), {}, 'posterior'),
    (detector_class('bernoulli')(), {}, 'posterior'), (Unknown(), {}, 'halo'),
    (detector_class('sdt')(restart='unused'), {}, 'restart'),
    (detector_class('sdt')(move_prior=True, destination=Destination(
        probability=0.5, x_m=3.0, y_m=3.0, arrival_frame=9)), {}, 'destination'),
    (detector_class('sdt')(), {'operating_point': 'adaptive'}, 'adaptive'),
    (detector_class('sdt')(), {'statistic_map': True}, 'statistic_map')])
def test_detector_that_needs_the_whole_frame_is_refused(detector, operating, words):
    with pytest.raises(ValueError, match=words) as caught:
        divisible(detector, replace(NOMINAL, **operating))
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(('rows', 'down', 'across', 'words'), [
    (8, 0, 1, '0 tiles cannot divide the 8 rows of a frame: set 1 to 8'),
    (8, 8, 0, '0 tiles cannot divide the 44 columns of a frame: set 1 to 44'),
    (8, 9, 2, '9 tiles cannot divide the 8 rows of a frame: set 1 to 8'),
    (0, 1, 1, 'the rows of a frame are not known: set rows and cols')])
def test_tiles_that_do_not_divide_the_frame_are_refused(rows, down, across, words):
    with pytest.raises(ValueError, match=f'^{words}$'):
        tiles_of(build('cdt', {}), (rows, 44), TileSettings(tiles_down=down, tiles_across=across))
