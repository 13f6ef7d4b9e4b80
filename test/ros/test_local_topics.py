# SPDX-License-Identifier: Apache-2.0
"""Nodes of one process hand messages over as the objects they are, and only to each other."""

from lowsnr_common.core.records import Malformed
from lowsnr_common.ros.images import LocalFrame
from lowsnr_common.ros.messages import frame_to_image
from lowsnr_common.ros.messages import image_to_frame
from lowsnr_common.ros.messages import stamp_from_seconds
from lowsnr_common.ros.process.local_topics import LocalTopics
from lowsnr_detect.node.detector_node import DetectorNode
from lowsnr_track.tracker_node import TrackerNode
import numpy as np
import pytest
from rclpy.parameter import Parameter
from sensor_msgs.msg import Image
from std_msgs.msg import Header


def made(context, local, kind, *arguments, **values):
    """Return a node that shares topics and does not start itself."""
    node = kind(*arguments, context=context, parameter_overrides=[
        Parameter(name, value=value)
        for name, value in ({'autostart': True} | values).items()])
    node.share(local)
    return node


@pytest.fixture
def chain(context):
    """Return a detector and a tracker that share topics, both active."""
    soon = []
    local = LocalTopics(soon.append)
    tracker = made(context, local, TrackerNode)
    detector = made(
        context, local, DetectorNode, 'cdt', operating_point='manual', threshold=8.0, rows=10,
        cols=12)
    assert tracker.autostart()
    assert detector.autostart()
    yield detector, tracker, soon
    detector.destroy_node()
    tracker.destroy_node()


def frame(k):
    """Return a frame with one bright cell, as an image."""
    cells = np.zeros((10, 12))
    cells[4, 5 + k] = 30.0
    return frame_to_image(cells, Header(stamp=stamp_from_seconds(float(k)), frame_id='camera'))


def test_tracker_gets_the_very_message_after_the_callback_of_the_detector(chain, spin):
    detector, tracker, soon = chain
    got = []
    tracker.local.join('/detections', got.append)
    detector._on_frame(frame(1))
    assert not got
    assert tracker.counts['in'] == 0
    while soon:
        soon.pop(0)()
    assert tracker.counts['in'] == tracker.counts['out'] == 1
    message, = got
    assert len(message.detections) == 1
    assert message.header.frame_id == 'camera'


def test_tracker_subscribes_to_nothing_that_it_is_handed(chain):
    detector, tracker, _ = chain
    assert not tracker.count_subscribers('/detections')
    assert detector.count_subscribers('/image_raw') == 1
    assert detector.local.readers('/detections') == 1
    assert not detector.local.readers('/image_raw')
    assert not tracker._lasting_faults()
    tracker.trigger_deactivate()
    tracker.trigger_cleanup()
    assert not detector.local.readers('/detections')


def test_a_node_alone_shares_nothing(context):
    node = TrackerNode(context=context)
    node.trigger_configure()
    assert node.count_subscribers('/detections') == 1
    node.destroy_node()


def test_a_frame_that_is_handed_over_is_checked_as_an_image_is():
    cells = np.arange(12, dtype=np.float32).reshape(3, 4)
    same = image_to_frame(LocalFrame(Header(), cells))
    assert same.dtype == np.float64
    np.testing.assert_array_equal(same, image_to_frame(frame_to_image(cells, Header())))
    assert not np.shares_memory(same, cells)
    cells[1, 2] = np.nan
    with pytest.raises(Malformed) as caught:
        image_to_frame(LocalFrame(Header(), cells))
    assert caught.value.reason == 'cell not a finite number'
    with pytest.raises(Malformed):
        image_to_frame(Image(encoding='mono8'))
