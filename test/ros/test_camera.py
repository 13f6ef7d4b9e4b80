"""What bring-up sees of a camera before a run, and says of it while one goes on."""

import threading

from diagnostic_msgs.msg import DiagnosticStatus
from graph_runs import own_domain
from lowsnr_bringup.ros.camera import look_at_camera
from lowsnr_bringup.ros.camera_watch import CameraWatch
from lowsnr_common.ros.messages import stamp_from_seconds
import pytest
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo
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
    monkeypatch.setenv('ROS_DOMAIN_ID', str(own_domain()))
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
    seen = look_at_camera(TOPIC, 60.0)
    assert (seen.name, seen.rows, seen.cols, seen.encoding) == ('camera/image_raw', 3, 5, 'mono16')
    assert seen.period_s == pytest.approx(0.04)
    assert (seen.raw, seen.truth, seen.simulated, seen.frames) == (True, False, False, 0)


@pytest.mark.parametrize(('make', 'said'), [
    (lambda k: image(k, 'bgr8'), "encoding is 'bgr8', must be one of mono8"),
    (lambda k: image(k, rows=0), 'frame of 5 x 0 cells is empty'),
    (lambda k: image(k, rows=3 + k % 2), 'its frames are of 5 x 3 and 5 x 4 pixels'),
    (lambda k: image(0.0), r'the stamps of its frames do not grow \(0, 0, 0, 0, 0 s\)'),
])
def test_frames_that_cannot_be_used_are_refused_by_topic(camera, make, said):
    camera(make)
    with pytest.raises(ValueError, match=f'{TOPIC}: {said}') as caught:
        look_at_camera(TOPIC, 60.0)
    assert '\n' not in str(caught.value)


def test_other_type_is_named_with_the_topics_that_will_do(camera):
    camera(image, topic='/right/image_raw')
    camera(lambda _: CameraInfo(), kind=CameraInfo)
    with pytest.raises(ValueError, match=f'{TOPIC}: is of type sensor_msgs/msg/CameraInfo, not '
                       'sensor_msgs/msg/Image') as caught:
        look_at_camera(TOPIC, 60.0)
    assert '\n' not in str(caught.value)


def test_topic_that_nobody_publishes_is_named_with_those_that_will_do(camera):
    camera(image)
    with pytest.raises(ValueError, match='/camera/raw: nobody publishes it; --camera can be '
                       f'{TOPIC}$'):
        look_at_camera('/camera/raw', 3.0)


def test_camera_that_sends_nothing_is_named(camera, context):
    node = Node('driver', context=context)
    node.create_publisher(Image, TOPIC, RELIABLE)
    with pytest.raises(ValueError, match=f'{TOPIC}: 0 of 2 frames came within 3 s from /driver'):
        look_at_camera(TOPIC, 3.0)
    node.destroy_node()


def test_trouble_is_said_once_and_its_end(capsys):
    now_s = [0.0]
    watch = CameraWatch(clock=lambda: now_s[0])

    def said(*messages, level=DiagnosticStatus.ERROR, after_s=1.0):
        for message in messages:
            now_s[0] += after_s
            watch.look(DiagnosticStatus(level=level, message=message))
        return capsys.readouterr().err.split('bringup.py: ')[1:]

    away, mute = '/cam: nobody publishes it', '/cam: silent for {} s'
    assert said(mute.format(11), mute.format(12)) == ['/cam: silent for 11 s\n']
    assert said(away, f'{mute.format(14)}; {away}') == [f'{away}\n']
    back = said('', '', level=DiagnosticStatus.OK)
    assert back == ['frames come again\n']
    assert said(away) == [f'{away}\n']
    # A slow camera is all right between two late frames.
    late = 'image_raw: stamp {} s is not after 1795658474.5; going on'
    assert said(late.format(3), '', late.format(4.5), level=DiagnosticStatus.WARN) == [
        'frames come again\n', f'{late.format(3)}\n']
    assert said('/cam: 2 publishers: /a, /b; ' + late.format(5), level=DiagnosticStatus.WARN) == [
        '/cam: 2 publishers: /a, /b\n']
    assert said(late.format(5), level=DiagnosticStatus.WARN, after_s=30) == []
    assert said(late.format(6), level=DiagnosticStatus.WARN, after_s=61) == [
        f'{late.format(6)}\n']
