# SPDX-License-Identifier: Apache-2.0
"""Both ends of a connection that does not fit are named; time that goes back ends nothing."""

import time

from bringup_end import BringupEnd
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue
from graph_runs import ROOT
from lowsnr_common.core.timeline import SET_BACK_AFTER
from lowsnr_common.ros import messages
from lowsnr_common.ros.connections import OTHER_QOS
from lowsnr_common.ros.connections import OTHER_TYPE
from lowsnr_common.ros.connections import SEVERAL_PUBLISHERS
from lowsnr_common.ros.diagnostics import faults_of
from lowsnr_common.ros.inputs import NO_PUBLISHER
from lowsnr_common.ros.inputs import SILENT
from lowsnr_common.ros.managed_node import SET_BACK
from lowsnr_common.ros.run_records import ChainCounts
from lowsnr_common.ros.run_records import FrameScored
from lowsnr_common.ros.run_records import NodeRestarted
from lowsnr_sensor.conditioner_node import ConditionerNode
from lowsnr_sensor.sensor_node import SensorNode
from lowsnr_track.tracker_node import TrackerNode
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.clock import ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy
from rclpy.qos import qos_profile_sensor_data
from rclpy.qos import QoSProfile
from ros_nodes import node_domain
from ros_nodes import spun_node
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2D
from vision_msgs.msg import Detection2DArray

DEPTH = QoSProfile(depth=1000)
SCENARIO = ROOT / 'config' / 'scenarios' / 'example4.yaml'


@pytest.fixture
def tracker(context):
    node = TrackerNode(context=context, parameter_overrides=[
        Parameter('rows', value=16), Parameter('cols', value=24),
        Parameter('silence_s', value=0.5)])
    node.autostart()
    yield node
    node.destroy_node()


@pytest.fixture
def other(context):
    node = Node('other', context=context)
    yield node
    node.destroy_node()


@pytest.fixture
def status_with(tracker, other, spin):
    """Return a function that waits for a status of the tracker with a fault, and returns it."""
    reports = []
    other.create_subscription(DiagnosticArray, '/diagnostics', reports.append, DEPTH)

    def wait(fault='', *names, level=None):
        def found():
            return [status for report in reports for status in report.status
                    if (not fault or fault in faults_of(status))
                    and all(name in faults_of(status)[fault] for name in names)
                    and level in (None, status.level)]
        spin(found, tracker, other)
        return found()[-1]

    return wait


def test_best_effort_publisher_is_named_with_the_policy(other, status_with):
    other.create_publisher(Detection2DArray, 'detections', qos_profile_sensor_data)
    # The middleware names the policy.
    status_with(f'/detections {OTHER_QOS}', '/other', 'Best effort publisher',
                level=DiagnosticStatus.ERROR)


def test_reader_that_does_not_fit_is_named_with_the_policy(other, status_with):
    lasting = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    other.create_subscription(Detection2DArray, 'tracks', print, lasting)
    status_with(f'/tracks {OTHER_QOS}', '/other', 'transient local subscription',
                level=DiagnosticStatus.ERROR)


def test_publisher_of_another_type_is_named(status_with):
    with spun_node('stranger', node_domain()) as (stranger, _):
        stranger.create_publisher(Odometry, 'detections', DEPTH)
        status_with(
            f'/detections {OTHER_TYPE}', '/stranger', 'nav_msgs/msg/Odometry',
            'vision_msgs/msg/Detection2DArray', level=DiagnosticStatus.ERROR)


def test_two_publishers_are_named_and_forgotten_when_one_is_gone(other, status_with, context):
    second = Node('second', context=context)
    publishers = [
        node.create_publisher(Detection2DArray, 'detections', DEPTH) for node in (other, second)]
    status_with(f'/detections {SEVERAL_PUBLISHERS}', '/other', '/second',
                level=DiagnosticStatus.ERROR)
    second.destroy_publisher(publishers[1])
    second.destroy_node()
    alone = status_with(f'/detections {SILENT}', level=DiagnosticStatus.ERROR)
    assert f'/detections {SEVERAL_PUBLISHERS}' not in faults_of(alone)
    other.destroy_publisher(publishers[0])
    status_with(f'/detections {NO_PUBLISHER}', level=DiagnosticStatus.ERROR)


def test_status_has_counters_state_and_process_and_comes_at_once(other, tracker, status_with):
    values = {item.key: item.value for item in status_with().values}
    assert {'in', 'out', 'refused', 'late', 'lost'} <= set(values)
    assert values['state'] == 'active'
    assert int(values['process']) > 0


def test_timers_do_not_follow_the_clock_of_the_machine(tracker):
    assert {timer.clock.clock_type for timer in tracker.timers} == {ClockType.STEADY_TIME}


def array(stamp_s):
    """Return an empty array."""
    return Detection2DArray(header=Header(stamp=messages.stamp_from_seconds(stamp_s)))


def test_clock_set_back_is_reported_once_and_the_node_continues(
        other, tracker, status_with, spin):
    answers = []
    other.create_subscription(Detection2DArray, 'tracks', answers.append, DEPTH)
    publisher = other.create_publisher(Detection2DArray, 'detections', DEPTH)
    spin(lambda: publisher.get_subscription_count() and tracker.count_subscribers('tracks'),
         tracker, other)
    for stamp in [*range(101, 106), *range(1, 31)]:
        publisher.publish(array(float(stamp)))
    answered = [*range(101, 106), *range(SET_BACK_AFTER, 31)]
    spin(lambda: len(answers) == len(answered))
    assert [message.header.stamp.sec for message in answers] == answered
    status = status_with(f'detections {SET_BACK}', ' 105.000000000 s ', ' 10.000000000 s')
    values = {item.key: item.value for item in status.values}
    assert (values['set back'], values['late'], values['out']) == (
        '1', str(SET_BACK_AFTER - 1), str(len(answered)))


def test_array_of_too_many_entries_is_answered(other, tracker, status_with, spin):
    answers = []
    other.create_subscription(Detection2DArray, 'tracks', answers.append, DEPTH)
    publisher = other.create_publisher(Detection2DArray, 'detections', DEPTH)
    spin(lambda: publisher.get_subscription_count() and tracker.count_subscribers('tracks'),
         tracker, other)
    flood = array(1.0)
    flood.detections = [Detection2D()] * 10_001
    publisher.publish(flood)
    spin(lambda: len(answers) == 1)
    status = status_with('detections too many entries', '10001')
    assert ('detections too many entries', '1') in [(v.key, v.value) for v in status.values]


def test_frames_of_a_best_effort_camera_that_comes_late_are_received(context, other, spin):
    node = ConditionerNode(context=context)
    node.autostart()
    answers = []
    other.create_subscription(Image, 'conditioned/image_raw', answers.append, DEPTH)
    spin(lambda: node.count_subscribers('conditioned/image_raw'), node, other)
    camera = other.create_publisher(Image, 'image_raw', qos_profile_sensor_data)
    spin(camera.get_subscription_count)
    header = Header(stamp=messages.stamp_from_seconds(1.0))
    camera.publish(messages.frame_to_image(np.zeros((8, 8)), header))
    spin(lambda: answers)
    node.destroy_node()


def test_source_in_lockstep_goes_on_with_the_word_it_waits_for_alone(context, other, spin):
    node = SensorNode(context=context, parameter_overrides=[
        Parameter('scenario', value=str(SCENARIO)), Parameter('lockstep', value=True)])
    frames = []
    other.create_subscription(Image, 'image_raw', frames.append, DEPTH)
    publisher = other.create_publisher(DiagnosticArray, 'scored', DEPTH)
    node.autostart()
    spin(lambda: len(frames) == 1 and publisher.get_subscription_count(), node, other)
    rng = np.random.default_rng(2)
    for sec in (0, -5, 2, 2**31 - 1, *rng.integers(2, 2**31, 20)):
        status = DiagnosticStatus(name='x' * 10**5, values=[KeyValue(key='', value='nan')])
        publisher.publish(DiagnosticArray(
            header=Header(stamp=Time(sec=int(sec), nanosec=2**32 - 1)), status=[status]))
    first, second = (FrameScored(k * 1_000_000_000, k, (ChainCounts('cdt', 0, 0),)).to_message()
                     for k in (1, 2))
    publisher.publish(first)
    spin(lambda: len(frames) == 2)
    publisher.publish(first)  # once more
    publisher.publish(second)
    spin(lambda: len(frames) == 3)
    with BringupEnd(node) as bringup:
        bringup.say('restarts', NodeRestarted('/evaluator', 'was killed', 1.0).to_message())
        spin(lambda: len(frames) == 4)
    since = time.monotonic()
    spin(lambda: len(frames) == 5)  # the frame after a restart may be lost
    assert time.monotonic() - since < node.simulation.patience_s  # the usual one
    assert node.counts['out'] == 5
    # A frame that is scored late shows that none is lost: the source has its patience again.
    publisher.publish(first)
    spin(lambda: node._lockstep._patience_s == 15.0)
    node.destroy_node()


def test_source_in_lockstep_is_ahead_by_the_lag_and_ends_with_its_last_frame(
    context, other, spin,
):
    node = SensorNode(context=context, parameter_overrides=[
        Parameter('scenario', value=str(SCENARIO)), Parameter('lockstep', value=True),
        Parameter('lag', value=3), Parameter('frames', value=6)])
    stamps, told = [], []
    other.create_subscription(
        Image, 'image_raw', lambda image: stamps.append(image.header.stamp.sec), DEPTH)
    publisher = other.create_publisher(DiagnosticArray, 'scored', DEPTH)
    node.finish = lambda: told.append(len(stamps))  # in a process of its own it ends here
    node.autostart()
    spin(lambda: len(stamps) == 4 and publisher.get_subscription_count(), node, other)

    def score(k):
        publisher.publish(
            FrameScored(k * 1_000_000_000, k, (ChainCounts('cdt', 0, 0),)).to_message())

    score(1)
    spin(lambda: len(stamps) == 5)
    score(1)  # once more, and then a frame later than those before, which are passed
    score(3)
    spin(lambda: told and len(stamps) == 6)
    assert stamps == [1, 2, 3, 4, 5, 6]
    node.destroy_node()
