# SPDX-License-Identifier: Apache-2.0
"""What bring-up finds out about a camera before a run, and prints about nodes during one."""

import threading

import cv2
from lowsnr_bringup.ros.camera import CameraError
from lowsnr_bringup.ros.camera import inspect_camera
from lowsnr_bringup.ros.node_watch import FrameWatch
from lowsnr_bringup.ros.node_watch import StateWatch
from lowsnr_bringup.ros.node_watch import StrangerWatch
from lowsnr_common.ros.connections import OTHER_TYPE
from lowsnr_common.ros.connections import SEVERAL_PUBLISHERS
from lowsnr_common.ros.connections import UNKNOWN_NAME
from lowsnr_common.ros.diagnostics import Fault
from lowsnr_common.ros.diagnostics import Health
from lowsnr_common.ros.inputs import NO_PUBLISHER
from lowsnr_common.ros.inputs import SILENT
from lowsnr_common.ros.messages import stamp_from_seconds
import numpy as np
import pytest
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.qos import QoSProfile
from ros_nodes import node_domain
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import CompressedImage
from sensor_msgs.msg import Image
from std_msgs.msg import Header

TOPIC = '/camera/image_raw'
RELIABLE = QoSProfile(depth=10)


def image(stamp_s, encoding='mono16', rows=3, cols=5):
    """Return an image of zeros."""
    size = {'mono8': 1, 'mono16': 2, '32FC1': 4}.get(encoding, 3)
    return Image(
        header=Header(stamp=stamp_from_seconds(stamp_s)), encoding=encoding, height=rows,
        width=cols, step=size * cols, data=bytes(size * cols * rows))


@pytest.fixture
def camera(context, monkeypatch):
    """Return a function that has a camera publish until the test ends, frame k made by a call."""
    monkeypatch.setenv('ROS_DOMAIN_ID', str(node_domain()))
    node, over, threads = Node('camera', context=context), threading.Event(), []

    def publish(make, qos=RELIABLE, kind=Image, topic=TOPIC):
        publisher = node.create_publisher(kind, topic, qos)

        def run():
            k = 0
            while not over.wait(0.02):
                publisher.publish(make(k := k + 1))
        threads.append(threading.Thread(target=run))
        threads[-1].start()

    yield publish
    over.set()
    for thread in threads:
        thread.join()
    node.destroy_node()


@pytest.mark.parametrize('qos', [RELIABLE, qos_profile_sensor_data], ids=['reliable', 'effort'])
def test_size_encoding_and_period_are_seen(camera, qos):
    camera(lambda k: image(1e9 + 0.04 * k), qos)
    seen = inspect_camera(TOPIC, 60.0)
    assert (seen.name, seen.rows, seen.cols, seen.encoding) == ('camera/image_raw', 3, 5, 'mono16')
    assert seen.period_s == pytest.approx(0.04)
    assert (seen.raw, seen.truth, seen.simulated, seen.frames) == (True, False, False, 0)


def test_camera_may_send_pixels_without_a_value(camera):
    def blank(k):
        message = image(k, '32FC1')
        message.data = np.full(15, np.nan, np.float32).tobytes()
        return message
    camera(blank)
    assert inspect_camera(TOPIC, 60.0).encoding == '32FC1'


@pytest.mark.parametrize('value', [np.nan, 2e9, 1e9])
def test_frames_with_a_pixel_without_value_are_seen(camera, value):
    message = image(0.0, '32FC1')
    message.data = np.full((3, 5), value, 'f4').tobytes()

    def make(k):
        message.header.stamp = stamp_from_seconds(0.04 * k)
        return message
    camera(make)
    assert bool(inspect_camera(TOPIC, 60.0).blank) == (value != 1e9)


def test_compressed_camera_is_seen_as_what_it_is_unpacked_to(camera):
    data = cv2.imencode('.png', np.full((3, 5), 1000, np.uint16))[1].tobytes()
    camera(lambda k: CompressedImage(
        header=Header(stamp=stamp_from_seconds(0.04 * k)), format='mono16; png compressed',
        data=data), kind=CompressedImage)
    seen = inspect_camera(TOPIC, 60.0)
    assert (seen.rows, seen.cols, seen.encoding, seen.compressed) == (3, 5, 'mono16', True)


@pytest.mark.parametrize(('make', 'reason'), [
    (lambda k: image(k, '32FC3'), 'wrong encoding'),
    (lambda k: image(k, rows=0), 'empty frame'),
    (lambda k: image(k, rows=3 + k % 2), 'changing size'),
    (lambda k: image(0.0), 'constant stamps'),
])
def test_frames_that_cannot_be_used_are_rejected_with_a_reason(camera, make, reason):
    camera(make)
    with pytest.raises(CameraError) as caught:
        inspect_camera(TOPIC, 60.0)
    assert caught.value.reason == reason
    assert str(caught.value).startswith(f'{TOPIC}: ')
    assert '\n' not in str(caught.value)


def test_other_type_is_named_with_the_topics_that_can_be_used(camera):
    camera(image, topic='/right/image_raw')
    camera(lambda _: CameraInfo(), kind=CameraInfo)
    with pytest.raises(CameraError, match='sensor_msgs/msg/CameraInfo') as caught:
        inspect_camera(TOPIC, 60.0)
    assert caught.value.reason == OTHER_TYPE
    assert str(caught.value).startswith(f'{TOPIC}: ')
    assert '\n' not in str(caught.value)


def test_topic_that_nobody_publishes_is_named_with_those_that_can_be_used(camera):
    camera(image)
    with pytest.raises(CameraError, match=f'^/camera/raw: .* {TOPIC}$') as caught:
        inspect_camera('/camera/raw', 3.0)
    assert caught.value.reason == 'nobody publishes'


def test_camera_that_sends_nothing_is_named(camera, context):
    node = Node('driver', context=context)
    node.create_publisher(Image, TOPIC, RELIABLE)
    with pytest.raises(CameraError, match=f'{TOPIC}: 0 .*/driver') as caught:
        inspect_camera(TOPIC, 3.0)
    assert caught.value.reason == 'too few frames'
    node.destroy_node()


def test_fault_is_printed_once_and_that_it_is_over(capsys):
    now_s = [0.0]
    watch = FrameWatch(clock=lambda: now_s[0])
    health = Health()

    def printed(*statuses, after_s=1.0):
        """Return the lines that statuses print, each of lasting faults and a passing one."""
        for lasting, passing in statuses:
            now_s[0] += after_s
            health.fault = passing
            watch.update(health.status('/conditioner', lasting, {}))
        return [line.partition(': ')[2] for line in capsys.readouterr().err.splitlines()]

    away = Fault('/cam', 'no publisher', 'nobody publishes it')
    silent = [Fault('/cam', 'silent', f'no message for {n} s') for n in range(20)]
    assert printed(([silent[11]], None), ([silent[12]], None)) == [str(silent[11])]
    assert printed(([away], None), ([silent[14], away], None)) == [str(away)]
    back = printed(([], None), ([], None))
    assert len(back) == 1
    assert printed(([away], None)) == [str(away)]
    # A slow camera has no fault between two late frames.
    late = [Fault('image_raw', 'late stamp', f'stamp {n} s is not after 9 s') for n in range(7)]
    assert printed(([], late[3]), ([], None), ([], late[4])) == [*back, str(late[3])]
    two = Fault('/cam', 'several publishers', '2 publishers: /a, /b')
    assert printed(([two], late[5])) == [str(two)]
    assert printed(([], late[5])) == [*back, str(late[5])]
    assert printed(([], late[4]), after_s=30.0) == []
    assert printed(([], late[6]), after_s=61.0) == [str(late[6])]


def test_of_recorded_frames_what_is_wrong_with_them_is_printed(capsys):
    watch, health = FrameWatch(live=False), Health()
    health.fault = Fault('image_raw', 'blank frame', 'frame 7 is blank')
    lasting = [Fault('/image_raw', reason, 'text') for reason in (NO_PUBLISHER, SILENT)]
    for _ in range(2):
        watch.update(health.status('/conditioner', lasting, {}))
    watch.update(health.status('/conditioner', [], {}))
    line, = capsys.readouterr().err.splitlines()
    assert line.endswith(': image_raw: frame 7 is blank')


def test_a_stranger_is_named_once_its_name_is_discovered(capsys):
    now_s = [0.0]
    watch = StrangerWatch(clock=lambda: now_s[0])

    def printed(*names):
        """Return the lines that a second publisher of these names prints, a second each."""
        for name in names:
            now_s[0] += 1.0
            watch.update(Health().status('/sensor', [
                Fault('/clock', SEVERAL_PUBLISHERS, f'2 publishers: /sensor, {name}')], {}))
        return [line.rpartition(', ')[2] for line in capsys.readouterr().err.splitlines()]

    assert printed(UNKNOWN_NAME, UNKNOWN_NAME, '/late', '/late') == ['/late']
    now_s[0] += 100.0
    assert printed(*[UNKNOWN_NAME] * 20) == [UNKNOWN_NAME]


def test_change_of_state_is_printed_for_a_process_that_was_active(capsys):
    watch = StateWatch()

    def printed(process, *states):
        """Return the state that each printed line names first."""
        for state in states:
            watch.update('cdt.tracker', '/cdt/tracker', process, state)
        return [line.split()[3].strip(',') for line in capsys.readouterr().err.splitlines()]

    starting = ('unconfigured', 'configuring', 'inactive', 'activating', 'active', 'active')
    assert printed('7', *starting) == []
    assert printed('7', 'deactivating', 'inactive', 'inactive') == ['inactive']
    assert printed('7', 'cleaningup', 'unconfigured') == ['unconfigured']
    assert printed('7', 'inactive', 'active') == ['inactive', 'active']
    assert printed('8', *starting, 'inactive') == ['inactive']
