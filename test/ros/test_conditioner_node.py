"""The conditioner node answers every frame, and says where its cells lie in it."""

import array

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from lowsnr_common.ros import messages
from lowsnr_common.ros.frame_maps import info_to_map
from lowsnr_sensor.conditioner_node import ConditionerNode
from lowsnr_sensor.conditioning.conditioner import ConditioningSettings
import numpy as np
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import Image
from std_msgs.msg import Header

SHAPE = (14, 10)


@pytest.fixture
def client(context):
    node = Node('client', context=context)
    yield node
    node.destroy_node()


@pytest.fixture
def conditioner(context):
    node = ConditionerNode(context=context)
    node.autostart()
    yield node
    node.destroy_node()


def camera_image(frame, stamp_s):
    """Return an 8-bit image."""
    header = Header(stamp=messages.stamp_from_seconds(stamp_s), frame_id='camera')
    data = array.array('B', frame.astype(np.uint8).tobytes())
    return Image(header=header, height=frame.shape[0], width=frame.shape[1], encoding='mono8',
                 step=frame.shape[1], data=data)


def test_frames_are_conditioned_and_malformed_ones_answered_with_zeros(
    conditioner, client, spin, rng,
):
    answers, maps, motions, reports = [], [], [], []
    client.create_subscription(CameraInfo, 'conditioned/camera_info', maps.append, 100)
    client.create_subscription(TransformStamped, 'camera_motion', motions.append, 100)
    client.create_subscription(Image, 'conditioned/image_raw', answers.append, 100)
    client.create_subscription(DiagnosticArray, '/diagnostics', reports.append, 10)
    publisher = client.create_publisher(Image, 'image_raw', 100)
    spin(lambda: publisher.get_subscription_count()
         and conditioner.count_subscribers('conditioned/image_raw'), conditioner, client)
    frames = rng.integers(80, 120, (12, *SHAPE))
    images = [camera_image(frame, 30.0 * k**1.1) for k, frame in enumerate(frames, start=1)]
    first = camera_image(frames[0], 1.0)
    first.encoding = 'rgb8'
    images[8].step = 3
    images[10] = camera_image(frames[10, :, :8], 30.0 * 11**1.1)
    for one in [first, *images, images[4]]:
        publisher.publish(one)
    spin(lambda: len(answers) == 12 and conditioner.counts['late'] == 1)
    spin(lambda: len(maps) == len(motions) == 12)
    headers = [one.header for one in images]
    assert [one.header for one in maps] == [one.header for one in motions] == headers
    assert {one.child_frame_id for one in motions} == {'camera_scene'}
    assert [one.header.stamp for one in answers] == [one.stamp for one in headers]
    assert {one.header.frame_id for one in answers} == {'camera_cells'}
    settings = ConditioningSettings()
    state = settings.init(SHAPE)
    for k, answer in enumerate(answers):
        expected = np.zeros((7, 5))
        if k not in (8, 10):
            state, output = settings.step(state, frames[k].astype(np.uint8))
            expected = output.cells
        np.testing.assert_array_equal(messages.image_to_frame(answer), expected)
        where = settings.frame_map(output, 'camera', SHAPE)
        assert info_to_map(maps[k]) == where
        motion = motions[k].transform.translation
        assert (motion.x, motion.y) == where.to_image
        assert expected.any() == (k > 4 and k not in (8, 10))
    assert (conditioner.counts['in'], conditioner.counts['out']) == (13, 12)
    # The first frame, two later ones, and the late one.
    spin(lambda: any(
        {item.key: item.value for item in report.status[0].values}.get('refused') == '4'
        for report in reports))


def test_frames_that_came_before_activation_are_not_answered(context, client, spin):
    node = ConditionerNode(
        context=context, parameter_overrides=[Parameter('live', value=True)])
    answers = []
    client.create_subscription(Image, 'conditioned/image_raw', answers.append, 100)
    publisher = client.create_publisher(Image, 'image_raw', 100)
    node.trigger_configure()
    spin(lambda: publisher.get_subscription_count()
         and node.count_subscribers('conditioned/image_raw'), client)
    for stamp_s in (1.0, 2.0, 3.0):
        publisher.publish(camera_image(np.ones(SHAPE), stamp_s))
    publisher.wait_for_all_acked()
    node.trigger_activate()
    publisher.publish(camera_image(np.ones(SHAPE), 4.0))
    spin(lambda: answers, node)
    assert [answer.header.stamp.sec for answer in answers] == [4]
    node.destroy_node()
