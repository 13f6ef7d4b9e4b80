"""Who cannot be heard is named on both sides; time that goes back ends nothing."""

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue
from graph_runs import ROOT
from lowsnr_common.core.timeline import SET_BACK_AFTER
from lowsnr_common.ros import messages
from lowsnr_common.ros.run_records import ChainCounts
from lowsnr_common.ros.run_records import FrameScored
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
def said(tracker, other, spin):
    """Return a function that waits for words in the tracker's status, and returns the status."""
    reports = []
    other.create_subscription(DiagnosticArray, '/diagnostics', reports.append, DEPTH)

    def wait(*words, level=None):
        def found():
            return [status for report in reports for status in report.status
                    if all(word in status.message for word in words)
                    and level in (None, status.level)]
        spin(found, tracker, other)
        return found()[-1]

    return wait


def test_best_effort_publisher_is_named_with_the_policy(other, said):
    other.create_publisher(Detection2DArray, 'detections', qos_profile_sensor_data)
    said('/detections: not heard is /other', 'Best effort publisher and reliable subscription',
         level=DiagnosticStatus.ERROR)


def test_reader_that_cannot_be_reached_is_named_with_the_policy(other, said):
    lasting = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    other.create_subscription(Detection2DArray, 'tracks', print, lasting)
    said('/tracks: not reached is /other', 'transient local subscription',
         level=DiagnosticStatus.ERROR)


def test_publisher_of_another_type_is_named(said):
    with spun_node('stranger') as (stranger, _):
        stranger.create_publisher(Odometry, 'detections', DEPTH)
        said('/detections: not heard is /stranger, which publishes nav_msgs/msg/Odometry, '
             'not vision_msgs/msg/Detection2DArray', level=DiagnosticStatus.ERROR)


def test_two_publishers_are_named_and_forgotten_when_one_is_gone(other, said, context):
    second = Node('second', context=context)
    publishers = [
        node.create_publisher(Detection2DArray, 'detections', DEPTH) for node in (other, second)]
    said('/detections: 2 publishers: /other, /second', level=DiagnosticStatus.ERROR)
    second.destroy_publisher(publishers[1])
    second.destroy_node()
    said('/detections: silent for', level=DiagnosticStatus.ERROR)
    other.destroy_publisher(publishers[0])
    said('/detections: nobody publishes it', level=DiagnosticStatus.ERROR)


def test_status_has_counters_state_and_process_and_comes_at_once(other, tracker, said):
    values = {item.key: item.value for item in said().values}
    assert {'in', 'out', 'refused', 'late', 'lost'} <= set(values)
    assert values['state'] == 'active'
    assert int(values['process']) > 0


def test_timers_do_not_follow_the_clock_of_the_machine(tracker):
    assert {timer.clock.clock_type for timer in tracker.timers} == {ClockType.STEADY_TIME}


def array(stamp_s):
    """Return an empty array."""
    return Detection2DArray(header=Header(stamp=messages.stamp_from_seconds(stamp_s)))


def test_clock_set_back_is_said_once_and_the_node_goes_on(other, tracker, said, spin):
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
    status = said('detections: its clock was set back from 105 s to 10 s')
    values = {item.key: item.value for item in status.values}
    assert (values['set back'], values['late'], values['out']) == (
        '1', str(SET_BACK_AFTER - 1), str(len(answered)))


def test_array_of_too_many_entries_is_answered(other, tracker, said, spin):
    answers = []
    other.create_subscription(Detection2DArray, 'tracks', answers.append, DEPTH)
    publisher = other.create_publisher(Detection2DArray, 'detections', DEPTH)
    spin(lambda: publisher.get_subscription_count() and tracker.count_subscribers('tracks'),
         tracker, other)
    flood = array(1.0)
    flood.detections = [Detection2D()] * 10_001
    publisher.publish(flood)
    spin(lambda: len(answers) == 1)
    status = said('detections: 10001 entries, at most 10000')
    assert ('detections too many entries', '1') in [(v.key, v.value) for v in status.values]


def test_best_effort_camera_that_comes_late_is_heard(context, other, spin):
    node = ConditionerNode(context=context, parameter_overrides=[
        Parameter('truth', value=False)])
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
    publishers = {
        topic: other.create_publisher(DiagnosticArray, topic, DEPTH)
        for topic in ('scored', 'restarts')}
    node.autostart()
    spin(lambda: len(frames) == 1 and all(
        each.get_subscription_count() for each in publishers.values()), node, other)
    rng = np.random.default_rng(2)
    for publisher in publishers.values():
        for sec in (0, -5, 2, 2**31 - 1, *rng.integers(2, 2**31, 20)):
            status = DiagnosticStatus(name='x' * 10**5, values=[KeyValue(key='', value='nan')])
            publisher.publish(DiagnosticArray(
                header=Header(stamp=Time(sec=int(sec), nanosec=2**32 - 1)), status=[status]))
    first, second = (FrameScored(k * 1_000_000_000, k, (ChainCounts('cdt', 0, 0),)).to_message()
                     for k in (1, 2))
    publishers['scored'].publish(first)
    spin(lambda: len(frames) == 2)
    publishers['scored'].publish(first)  # once more
    publishers['scored'].publish(second)
    spin(lambda: len(frames) == 3)
    assert node.counts['out'] == 3
    node.destroy_node()
