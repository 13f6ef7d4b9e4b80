# SPDX-License-Identifier: Apache-2.0
"""The merger publishes one array for every frame, with or without all tiles."""


from bringup_end import BringupEnd
from diagnostic_msgs.msg import DiagnosticArray
from lowsnr_common.core.records import AlarmRate
from lowsnr_common.ros import messages
from lowsnr_common.ros.run_records import ALARM_RATE
from lowsnr_common.ros.run_records import NodeRestarted
from lowsnr_common.ros.run_records import rate_from_message
from lowsnr_common.ros.run_records import RESTARTS
from lowsnr_detect.tiles.exceedances import Exceedances
from lowsnr_detect.tiles.exceedances import NONE
from lowsnr_detect.tiles.merger_node import MergerNode
from lowsnr_detect.tiles.ros.clouds import exceedances_to_cloud
from lowsnr_detect.tiles.tile_join import WITHOUT_TILE
from lowsnr_detect.tiles.tile_node import TileNode
from nav_msgs.msg import Odometry
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
          'sensor.snr_db': 20.0, 'tiles_down': 1, 'tiles_across': 2, 'tile_within_s': 1000.0}


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
         and all(merger.count_publishers(f'exceedances/tile_{n}') for n in (1, 2)),
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


def exceedances_at(*cells):
    """Return exceedances in cells (row, column)."""
    count = len(cells)
    return Exceedances(
        np.array(cells), np.ones(count), np.array(cells, float)[:, ::-1], np.array(
            [np.eye(2)] * count))


def connected(merger, client, answers, spin):
    """Return publishers of what each tile found; what the merger publishes goes to answers."""
    client.create_subscription(Detection2DArray, 'detections', answers.append, 100)
    clouds = {n: client.create_publisher(PointCloud2, f'exceedances/tile_{n}', 100)
              for n in (1, 2)}
    spin(lambda: merger.count_subscribers('detections') and all(
        each.get_subscription_count() for each in clouds.values()), merger, client)
    return clouds


@pytest.fixture
def joined(make, client, spin):
    """Return a merger, what it published, and a function that sends what a tile found."""
    merger, answers = make(MergerNode, 'cdt', tile_within_s=0.3), []
    clouds = connected(merger, client, answers, spin)
    return merger, answers, lambda number, stamp_s, found=NONE: clouds[number].publish(
        exceedances_to_cloud(found, header(stamp_s)))


def test_frame_without_a_tile_is_answered_in_time_counted_and_reported(joined, client, spin):
    merger, answers, send = joined
    reports = []
    client.create_subscription(DiagnosticArray, '/diagnostics', reports.append, 10)
    send(1, 1, exceedances_at((2, 2)))
    spin(lambda: len(answers) == 1)
    assert places(answers[0]) == [(2.0, 2.0)]
    assert (merger.counts[WITHOUT_TILE], merger.counts['without exceedances/tile_2']) == (1, 1)
    spin(lambda: any(f'exceedances/tile_2 {WITHOUT_TILE}' in item.key
                     for report in reports for status in report.status for item in status.values))
    send(2, 1)  # it is back, too late for that frame
    spin(lambda: merger.counts['exceedances/tile_2 late exceedances'] == 1)


def test_stamps_that_come_again_after_a_clock_was_set_back_are_answered_again(
        make, client, spin):
    merger, answers = make(MergerNode, 'cdt'), []
    clouds = connected(merger, client, answers, spin)
    for answered in (14, 14 + 5):  # of those that come again nine are late
        for stamp in range(1, 15):
            for cloud in clouds.values():
                cloud.publish(exceedances_to_cloud(NONE, header(stamp)))
        spin(lambda count=answered: len(answers) == count)
    assert [answer.header.stamp.sec for answer in answers] == [*range(1, 15), *range(10, 15)]
    assert (merger.counts[WITHOUT_TILE], merger.counts['set back']) == (0, 2)


def test_merger_that_starts_again_does_not_wait_for_a_tile_that_is_away(make, client):
    for kind, topic in ((Detection2DArray, 'detections'), (Odometry, 'detections/odometry')):
        client.create_subscription(kind, topic, print, 10)
    assert make(MergerNode, 'cdt', lives=1, consumers=1).active


def test_frame_that_a_tile_lost_when_it_died_does_not_wait(make, client, spin):
    merger, answers = make(MergerNode, 'cdt'), []
    client.create_subscription(Detection2DArray, 'detections', answers.append, 10)
    cloud = client.create_publisher(PointCloud2, 'exceedances/tile_1', 10)
    spin(lambda: cloud.get_subscription_count() and merger.count_subscribers('detections'),
         merger, client)
    with BringupEnd(merger) as bringup:
        cloud.publish(exceedances_to_cloud(NONE, header(1)))
        spin(lambda: merger.counts['in'] == 1)
        for other in ('/cdt_detector', '/other/cdt_2', '/cdt_3'):
            bringup.say(RESTARTS, NodeRestarted(other, 'was killed', 1.0).to_message())
        cloud.publish(exceedances_to_cloud(NONE, header(2)))
        spin(lambda: merger.counts['in'] == 2)
        assert not answers
        bringup.say(RESTARTS, NodeRestarted('/cdt_2', 'was killed', 1.0).to_message())
        spin(lambda: len(answers) == 2)
    assert merger.counts[WITHOUT_TILE] == 2


def test_exceedances_that_cannot_be_are_rejected_and_the_frame_is_answered_without(joined, spin):
    merger, answers, send = joined
    send(1, 1, exceedances_at((2, 4)))  # in the other tile
    send(2, 1, exceedances_at((2, 4)))
    spin(lambda: len(answers) == 1)
    assert places(answers[0]) == [(4.0, 2.0)]
    assert merger.counts['exceedances/tile_1 other cells'] == 1


def test_bringup_gets_the_false_alarm_rate_that_was_asked(make):
    merger = make(MergerNode, 'cdt', operating_point='matched', false_alarm_prob=0.05)
    with BringupEnd(merger) as bringup:
        merger.report()
        newest = bringup.heard(ALARM_RATE, DiagnosticArray)[-1]
    assert rate_from_message(newest) == ('/cdt_detector', AlarmRate(0.05))
