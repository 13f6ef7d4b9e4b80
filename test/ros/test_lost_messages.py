# SPDX-License-Identifier: Apache-2.0
"""Messages that a reader loses are counted, whether the middleware reports them or not."""

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from lowsnr_common.ros.diagnostics import faults_of
from lowsnr_common.ros.inputs import LOST
from lowsnr_common.ros.inputs import LostMessages
from lowsnr_track.tracker_node import TrackerNode
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray

DEPTH = 1000


@pytest.fixture
def nodes(context):
    """Return a tracker and a node that publishes to it."""
    tracker, other = TrackerNode(context=context, parameter_overrides=[
        Parameter('rows', value=16), Parameter('cols', value=24)]), Node('other', context=context)
    tracker.autostart()
    yield tracker, other
    tracker.destroy_node()
    other.destroy_node()


def test_messages_that_come_faster_than_they_are_taken_are_counted_and_reported(nodes, spin):
    tracker, other = nodes
    seen = []
    other.create_subscription(
        DiagnosticArray, '/diagnostics', lambda report: seen.extend(report.status), DEPTH)
    publisher = other.create_publisher(Detection2DArray, 'detections', DEPTH)
    spin(publisher.get_subscription_count, *nodes)
    for k in range(1 + DEPTH + 7):
        publisher.publish(Detection2DArray(header=Header(stamp=Time(sec=k + 1))))
        assert publisher.wait_for_all_acked()
        if k == 0:
            spin(lambda: tracker.counts['in'] == 1, *nodes)
    spin(lambda: any('7 messages' in faults_of(status).get(f'detections {LOST}', '')
                     and status.level == DiagnosticStatus.WARN for status in seen), *nodes)
    spin(lambda: tracker.counts['in'] == 1 + DEPTH, *nodes)
    assert tracker.counts['lost'] == 7


def test_lost_messages_are_counted_once_and_those_of_other_publishers_never():
    there = {1}
    lost = LostMessages(lambda: set(there))
    assert [lost.arrived(number) for number in (5, 6, 9)] == [0, 0, 2]
    assert [lost.reported(count) for count in (1, 2)] == [1, 2]  # others than the gap
    assert [lost.arrived(number) for number in (12, 13, 18, 20)] == [0, 0, 3, 1]
    there.add(2)
    assert [lost.arrived(number) for number in (40, 14, 41, 15)] == [0, 0, 0, 0]
    there.remove(1)
    assert [lost.arrived(number) for number in (60, 61, 63)] == [0, 0, 1]
    there = {3}
    assert [lost.arrived(number) for number in (2, 3, 3, 5)] == [0, 0, 0, 1]
    assert lost.arrived(None) == lost.arrived(9) == 0  # another middleware gives no numbers


def test_report_from_before_a_gap_that_cannot_be_counted_hides_no_later_loss():
    there = {1}
    lost = LostMessages(lambda: set(there))
    assert lost.reported(5) == 5
    assert [lost.arrived(number) for number in (9, 15)] == [0, 5]
    assert lost.reported(4) == 4
    there = {2}
    assert [lost.arrived(number) for number in (3, 6)] == [0, 2]
    assert lost.reported(4) == 4
    assert [lost.arrived(number) for number in (None, 7, 9)] == [0, 0, 1]
