# SPDX-License-Identifier: Apache-2.0
"""The recorder in a run with a camera, which does not wait for subscribers."""

from pathlib import Path
from threading import Thread

from lowsnr_bringup import recorder_node
from lowsnr_bringup.bags.reader import Bag
from lowsnr_common.ros.qos import reliable
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import Image

TOPIC = '/camera/image_raw'


@pytest.fixture
def camera(context):
    """Return the publisher of a camera."""
    node = Node('camera', context=context)
    yield node.create_publisher(Image, TOPIC, reliable(10))
    node.destroy_node()


@pytest.fixture
def recorder(context, tmp_path):
    """Return a recorder of the camera, not started yet."""
    values = {'live': True, 'topics': [TOPIC], 'bag': str(tmp_path / 'bag')}
    node = recorder_node.RecorderNode(context=context, parameter_overrides=[
        Parameter(name, value=value) for name, value in values.items()])
    yield node
    node.destroy_node()


def test_recording_begins_before_the_run_does(camera, recorder, monkeypatch):
    monkeypatch.setattr(recorder_node, '_FIRST_FRAME_WITHIN_S', 60.0)
    start = Thread(target=recorder.autostart)
    start.start()
    start.join(1.0)
    assert not recorder.active  # the nodes that receive the camera become active after it
    for _ in range(1000):
        camera.publish(Image())
        start.join(0.05)
        if not start.is_alive():
            break
    assert recorder.active
    recorder.trigger_deactivate()
    with Bag(Path(recorder.recording.bag)) as bag:
        assert len(list(bag.messages({TOPIC}))) > 0


def test_recorder_does_not_wait_for_a_slow_camera(camera, recorder, monkeypatch):
    monkeypatch.setattr(recorder_node, '_FIRST_FRAME_WITHIN_S', 0.5)
    assert recorder.autostart()
    assert recorder.active
