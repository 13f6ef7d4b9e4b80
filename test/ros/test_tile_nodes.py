# SPDX-License-Identifier: Apache-2.0
"""The node that joins tiles publishes one array for every frame, with or without all tiles."""

import array

from bringup_end import BringupEnd
from diagnostic_msgs.msg import DiagnosticArray
from lowsnr_common.core.records import AlarmRate
from lowsnr_common.core.records import Malformed
from lowsnr_common.ros import messages
from lowsnr_common.ros.run_records import ALARM_RATE
from lowsnr_common.ros.run_records import NodeRestarted
from lowsnr_common.ros.run_records import rate_from_message
from lowsnr_common.ros.run_records import RESTARTS
from lowsnr_detect.tiles.crossings import Crossings
from lowsnr_detect.tiles.crossings import NONE
from lowsnr_detect.tiles.merger_node import MergerNode
from lowsnr_detect.tiles.ros.clouds import cloud_to_crossings
from lowsnr_detect.tiles.ros.clouds import crossings_to_cloud
from lowsnr_detect.tiles.tile import Tile
from lowsnr_detect.tiles.tile_join import WITHOUT_TILE
from lowsnr_detect.tiles.tile_node import TileNode
import numpy as np
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import Image
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray

SHAPE = (7, 6)
VALUES = {'operating_point': 'manual', 'threshold': 20.0, 'rows': SHAPE[0], 'cols': SHAPE[1],
          'sensor.snr_db': 20.0, 'tiles_down': 1, 'tiles_across': 2}
TILE = Tile((0, 7), (3, 6), (0, 7), (3, 6))
TWO = Crossings(np.array([[1, 4], [6, 5]]), np.array([0.25, 70.5]),
                np.array([[4.125, 1.0], [5.0, 6.0]]), np.array([0.25 * np.eye(2), np.eye(2)]))


@pytest.fixture
def make(context):
    """Return a function that starts a node of a divided detector."""
    nodes = []

    def start(kind, *arguments, **values):
        nodes.append(kind(*arguments, context=context, parameter_overrides=[
            Parameter(name, value=value) for name, value in (VALUES | values).items()]))
        nodes[-1].autostart()
        return nodes[-1]

    yield start
    for node in nodes:
        node.destroy_node()


@pytest.fixture
def client(context):
    node = Node('client', context=context)
    yield node
    node.destroy_node()


def header(stamp_s):
    return Header(stamp=messages.stamp_from_seconds(stamp_s), frame_id='sensor')


def image(stamp_s, *bright, shape=SHAPE):
    """Return an image with bright cells."""
    frame = np.zeros(shape)
    for cell in bright:
        frame[cell] = 10.0
    return messages.frame_to_image(frame, header(stamp_s))


def places(answer):
    """Return column and row of each detection."""
    centres = [item.bbox.center.position for item in answer.detections]
    return [(centre.x, centre.y) for centre in centres]


def test_frames_are_answered_once_from_all_tiles(make, client, spin):
    merger = make(MergerNode, 'cdt')
    tiles = [make(TileNode, 'cdt', number) for number in (1, 2)]
    answers = []
    client.create_subscription(Detection2DArray, 'detections', answers.append, 10)
    frames = client.create_publisher(Image, 'image_raw', 10)
    spin(lambda: frames.get_subscription_count() == 2 and merger.count_subscribers('detections')
         and all(merger.count_publishers(f'crossings/tile_{n}') for n in (1, 2)),
         merger, client, *tiles)
    sent = [image(1, (4, 2), (2, 5)), image(2, (0, 3)), image(3, shape=(7, 5)), image(4)]
    for each in sent:
        frames.publish(each)
    spin(lambda: len(answers) == 4)
    assert [sorted(places(answer)) for answer in answers] == [
        [(2.0, 4.0), (5.0, 2.0)], [(3.0, 0.0)], [], []]
    assert [answer.header for answer in answers] == [each.header for each in sent]
    assert [tile.counts['refused'] for tile in tiles] == [1, 1]
    assert merger.counts[WITHOUT_TILE] == 0


def crossings_at(*cells):
    """Return crossings in cells (row, column)."""
    count = len(cells)
    return Crossings(
        np.array(cells), np.ones(count), np.array(cells, float)[:, ::-1], np.array(
            [np.eye(2)] * count))


@pytest.fixture
def joined(make, client, spin):
    """Return a joining node, what it published, and a function that sends what a tile found."""
    merger, answers = make(MergerNode, 'cdt', tile_within_s=0.3), []
    client.create_subscription(Detection2DArray, 'detections', answers.append, 10)
    clouds = {n: client.create_publisher(PointCloud2, f'crossings/tile_{n}', 10) for n in (1, 2)}
    spin(lambda: merger.count_subscribers('detections') and all(
        each.get_subscription_count() for each in clouds.values()), merger, client)
    return merger, answers, lambda number, stamp_s, found=NONE: clouds[number].publish(
        crossings_to_cloud(found, header(stamp_s)))


def test_frame_without_a_tile_is_answered_in_time_counted_and_reported(joined, client, spin):
    merger, answers, send = joined
    reports = []
    client.create_subscription(DiagnosticArray, '/diagnostics', reports.append, 10)
    send(1, 1, crossings_at((2, 2)))
    spin(lambda: len(answers) == 1)
    assert places(answers[0]) == [(2.0, 2.0)]
    assert (merger.counts[WITHOUT_TILE], merger.counts['without crossings/tile_2']) == (1, 1)
    spin(lambda: any(f'crossings/tile_2 {WITHOUT_TILE}' in item.key
                     for report in reports for status in report.status for item in status.values))
    send(2, 1)  # it is back, too late for that frame
    spin(lambda: merger.counts['crossings/tile_2 late crossings'] == 1)
    send(1, 2)
    send(2, 2, crossings_at((0, 5)))
    spin(lambda: len(answers) == 2)
    assert places(answers[1]) == [(5.0, 0.0)]
    assert merger.counts[WITHOUT_TILE] == 1


def test_frame_that_a_tile_lost_when_it_died_does_not_wait(make, client, spin):
    merger, answers = make(MergerNode, 'cdt', tile_within_s=1000.0), []
    client.create_subscription(Detection2DArray, 'detections', answers.append, 10)
    cloud = client.create_publisher(PointCloud2, 'crossings/tile_1', 10)
    spin(lambda: cloud.get_subscription_count() and merger.count_subscribers('detections'),
         merger, client)
    with BringupEnd(merger) as bringup:
        cloud.publish(crossings_to_cloud(NONE, header(1)))
        spin(lambda: merger.counts['in'] == 1)
        for other in ('/cdt_detector', '/other/cdt_2', '/cdt_3'):
            bringup.say(RESTARTS, NodeRestarted(other, 'was killed', 1.0).to_message())
        cloud.publish(crossings_to_cloud(NONE, header(2)))
        spin(lambda: merger.counts['in'] == 2)
        assert not answers
        bringup.say(RESTARTS, NodeRestarted('/cdt_2', 'was killed', 1.0).to_message())
        spin(lambda: len(answers) == 2)
    assert merger.counts[WITHOUT_TILE] == 2


def test_crossings_that_cannot_be_are_rejected_and_the_frame_is_answered_without(joined, spin):
    merger, answers, send = joined
    send(1, 1, crossings_at((2, 4)))  # in the other tile
    send(2, 1, crossings_at((2, 4)))
    spin(lambda: len(answers) == 1)
    assert places(answers[0]) == [(4.0, 2.0)]
    assert merger.counts['crossings/tile_1 other cells'] == 1


def test_bringup_gets_the_false_alarm_rate_that_was_asked(make):
    merger = make(MergerNode, 'cdt', operating_point='matched', false_alarm_prob=0.05)
    with BringupEnd(merger) as bringup:
        merger.report()
        newest = bringup.heard(ALARM_RATE, DiagnosticArray)[-1]
    assert rate_from_message(newest) == ('/cdt_detector', AlarmRate(0.05))


def test_crossings_pass_a_message_unchanged():
    found = cloud_to_crossings(crossings_to_cloud(TWO, header(1)), TILE)
    for name in ('cell', 'excess', 'place', 'cov'):
        np.testing.assert_array_equal(getattr(found, name), getattr(TWO, name))
    assert len(cloud_to_crossings(crossings_to_cloud(NONE, header(1)), TILE).excess) == 0


def cloud(**changes):
    """Return the cloud of two crossings with other values of the message."""
    made = crossings_to_cloud(TWO, header(1))
    for name, value in changes.items():
        setattr(made, name, value)
    return made


def edited(name, value):
    """Return the cloud of two crossings, of which the second has another value."""
    made = crossings_to_cloud(TWO, header(1))
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
    (edited('y', 7.0), 'other cells'), (edited('excess', 0.0), 'no crossing'),
    (edited('excess', np.nan), 'value out of bounds'),
    (edited('x', np.inf), 'value out of bounds'),
    (edited('cov_xy', -1e10), 'value out of bounds')])
def test_cloud_that_a_tile_does_not_send_is_rejected_by_its_reason(message, reason):
    with pytest.raises(Malformed) as caught:
        cloud_to_crossings(message, TILE)
    assert caught.value.reason == reason


def test_crossing_that_is_there_twice_is_rejected():
    twice = TWO[np.array([0, 0])]
    with pytest.raises(Malformed) as caught:
        cloud_to_crossings(crossings_to_cloud(twice, header(1)), TILE)
    assert caught.value.reason == 'other cells'
