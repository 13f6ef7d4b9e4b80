# SPDX-License-Identifier: Apache-2.0
"""A cloud of exceedances passes unchanged, and one that no tile sends is rejected."""

import array

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.records import Malformed
from lowsnr_common.ros import messages
from lowsnr_common.settings.node_settings import TileSettings
from lowsnr_detect.parts.registry import detector_class
from lowsnr_detect.tiles.exceedances import Exceedances
from lowsnr_detect.tiles.exceedances import exceedances_in
from lowsnr_detect.tiles.exceedances import NONE
from lowsnr_detect.tiles.ros.clouds import cloud_to_exceedances
from lowsnr_detect.tiles.ros.clouds import exceedances_to_cloud
from lowsnr_detect.tiles.tile import Tile
from lowsnr_detect.tiles.tile import tiles_of
import numpy as np
import pytest
from std_msgs.msg import Header

SHAPE = (7, 6)
CDT = detector_class('cdt')()
TILE = Tile((0, 7), (3, 6), (0, 7), (3, 6))
TWO = Exceedances(np.array([[1, 4], [6, 5]]), np.array([0.25, 70.5]),
                  np.array([[4.125, 1.0], [5.0, 6.0]]), np.array([0.25 * np.eye(2), np.eye(2)]))


def header(stamp_s):
    return Header(stamp=messages.stamp_from_seconds(stamp_s), frame_id='sensor')


def test_exceedances_pass_a_message_unchanged():
    found = cloud_to_exceedances(exceedances_to_cloud(TWO, header(1)), TILE, CDT)
    for name in ('cell', 'excess', 'place', 'cov'):
        np.testing.assert_array_equal(getattr(found, name), getattr(TWO, name))
    assert len(cloud_to_exceedances(exceedances_to_cloud(NONE, header(1)), TILE, CDT).excess) == 0


def cloud(**changes):
    """Return the cloud of two exceedances with other values of the message."""
    made = exceedances_to_cloud(TWO, header(1))
    for name, value in changes.items():
        setattr(made, name, value)
    return made


def edited(name, value):
    """Return the cloud of two exceedances, of which the second has another value."""
    made = exceedances_to_cloud(TWO, header(1))
    kind = np.dtype({
        'names': [item.name for item in made.fields],
        'formats': [{7: '<f4', 8: '<f8'}[item.datatype] for item in made.fields],
        'offsets': [item.offset for item in made.fields], 'itemsize': made.point_step})
    points = np.frombuffer(bytes(made.data), kind).copy()
    points[name][1] = value
    made.data = array.array('B', points.tobytes())
    return made


@pytest.mark.parametrize(('message', 'reason'), [
    (cloud(width=3), 'other fields'), (cloud(height=2), 'other fields'),
    (cloud(point_step=8), 'other fields'), (cloud(fields=[]), 'other fields'),
    (cloud(is_bigendian=True), 'other fields'),
    (cloud(data=array.array('B', bytes(5))), 'other fields'),
    (edited('x', 2.0), 'other cells'), (edited('x', 4.5), 'other cells'),
    (edited('y', 7.0), 'other cells'), (edited('excess', 0.0), 'no exceedance'),
    (edited('excess', np.nan), 'not finite'),
    (edited('excess', np.inf), 'not finite'), (edited('x', np.inf), 'not finite'),
    (edited('x', 3e38), 'other cells'), (edited('y', -3e38), 'other cells'),
    (edited('place_x', 5.51), 'far from its cell'),
    (edited('place_y', -1e300), 'far from its cell'),
    (edited('cov_xy', -1.0), 'no covariance'), (edited('cov_xy', 1e300), 'no covariance'),
    (edited('cov_xx', 0.0), 'no covariance'), (edited('cov_yy', -1.0), 'no covariance')])
def test_cloud_that_a_tile_does_not_send_is_rejected_by_its_reason(message, reason):
    with pytest.raises(Malformed) as caught:
        cloud_to_exceedances(message, TILE, CDT)
    assert caught.value.reason == reason


def test_exceedance_that_is_there_twice_is_rejected():
    twice = TWO[np.array([0, 0])]
    with pytest.raises(Malformed) as caught:
        cloud_to_exceedances(exceedances_to_cloud(twice, header(1)), TILE, CDT)
    assert caught.value.reason == 'other cells'


@pytest.mark.parametrize('name', ['cdt', 'sdt'])
def test_brightest_frame_that_a_tile_reads_passes_its_merger(name):
    detector = detector_class(name)(threshold=5.0, sensor=SensorModel(noise_std=0.01))
    tile, = tiles_of(detector, SHAPE, TileSettings(tiles_down=1, tiles_across=1))
    frame = messages.image_to_frame(messages.frame_to_image(np.diag([1e9] * 7)[:, :6], header(1)))
    _, found = exceedances_in(detector, tile, detector.init(SHAPE), frame)
    assert found.excess.max() > 1e9
    got = cloud_to_exceedances(exceedances_to_cloud(found, header(1)), tile, detector)
    np.testing.assert_array_equal(got.excess, found.excess)
