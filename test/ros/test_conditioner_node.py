"""The conditioner node answers every frame, and converts the truth to cells."""

import array

from diagnostic_msgs.msg import DiagnosticArray
from lowsnr_common.core.records import Estimate
from lowsnr_common.ros import messages
from lowsnr_sensor.conditioner_node import ConditionerNode
from lowsnr_sensor.conditioning.conditioner import ConditioningSettings
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray

SHAPE = (14, 10)


@pytest.fixture
def client(context):
    node = Node('client', context=context)
    yield node
    node.destroy_node()


@pytest.fixture
def conditioner(context):
    node = ConditionerNode(context=context, parameter_overrides=[
        Parameter('sensor.cell_size_m', value=2.0)])
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
    answers, reports = [], []
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
    assert [answer.header for answer in answers] == [one.header for one in images]
    settings = ConditioningSettings()
    state = settings.init(SHAPE)
    for k, answer in enumerate(answers):
        expected = np.zeros((7, 5))
        if k not in (8, 10):
            state, output = settings.step(state, frames[k].astype(np.uint8))
            expected = output.cells
        np.testing.assert_array_equal(messages.image_to_frame(answer), expected)
        assert expected.any() == (k > 4 and k not in (8, 10))
    assert (conditioner.counts['in'], conditioner.counts['out']) == (13, 12)
    # The first frame, two later ones, and the late one.
    spin(lambda: any(
        {item.key: item.value for item in report.status[0].values}.get('refused') == '4'
        for report in reports))


def test_truth_is_published_in_cells_of_the_conditioned_frame(conditioner, client, spin):
    arrays, states = [], []
    client.create_subscription(
        Detection2DArray, 'conditioned/ground_truth', arrays.append, 10)
    client.create_subscription(
        Odometry, 'conditioned/ground_truth/odometry', states.append, 10)
    array_out = client.create_publisher(Detection2DArray, 'ground_truth', 10)
    state_out = client.create_publisher(Odometry, 'ground_truth/odometry', 10)
    spin(lambda: array_out.get_subscription_count() and state_out.get_subscription_count()
         and conditioner.count_subscribers('conditioned/ground_truth')
         and conditioner.count_subscribers('conditioned/ground_truth/odometry'),
         conditioner, client)
    header = Header(stamp=messages.stamp_from_seconds(4.0), frame_id='camera')
    # Pixel (2.5, 8.5) at 2 m a pixel lies at the centre of cell (1, 4).
    item = Estimate(np.array([5.0, 3.0, 17.0, -1.0]), np.eye(4), 1.0, 'a')
    array_out.publish(messages.estimates_to_array([item], header, 2.0))
    state_out.publish(messages.estimate_to_odometry(item, header))
    spin(lambda: arrays and states)
    centre = arrays[0].detections[0].bbox.center.position
    assert (centre.x, centre.y) == (1.0, 4.0)
    assert arrays[0].header == states[0].header == header
    assert arrays[0].detections[0].id == states[0].child_frame_id == 'a'
    back = messages.odometry_to_estimate(states[0], 1.0)
    np.testing.assert_array_equal(back.state, [2.0, 1.5, 8.0, -0.5])


def test_without_truth_its_topics_do_not_exist(context):
    node = ConditionerNode(context=context, parameter_overrides=[Parameter('truth', value=False)])
    node.autostart()
    assert node.active
    assert not node.count_publishers('conditioned/ground_truth')
    assert not node.count_subscribers('ground_truth')
    node.destroy_node()


def test_frames_that_came_before_activation_are_not_answered(context, client, spin):
    node = ConditionerNode(context=context, parameter_overrides=[
        Parameter('truth', value=False), Parameter('live', value=True)])
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
