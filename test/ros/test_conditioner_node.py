# SPDX-License-Identifier: Apache-2.0
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
import scipy.ndimage
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import Image
from std_msgs.msg import Header

SHAPE = (14, 10)
SCENE = (48, 64)


@pytest.fixture
def client(context):
    node = Node('client', context=context)
    yield node
    node.destroy_node()


@pytest.fixture
def conditioner(context, request):
    node = ConditionerNode(context=context, parameter_overrides=[
        Parameter('lives', value=getattr(request, 'param', 0))])
    node.autostart()
    yield node
    node.destroy_node()


def camera_image(frame, stamp_s):
    """Return an 8-bit image."""
    header = Header(stamp=messages.stamp_from_seconds(stamp_s), frame_id='camera')
    data = array.array('B', frame.astype(np.uint8).tobytes())
    return Image(header=header, height=frame.shape[0], width=frame.shape[1], encoding='mono8',
                 step=frame.shape[1], data=data)


@pytest.fixture
def answers(conditioner, client, spin):
    """Return a function that sends images, and returns what is heard of the topics by then."""
    heard = {'conditioned/image_raw': [], 'conditioned/camera_info': [], 'camera_motion': []}
    for topic, kind in zip(heard, (Image, CameraInfo, TransformStamped)):
        client.create_subscription(kind, topic, heard[topic].append, 100)
    publisher = client.create_publisher(Image, 'image_raw', 100)
    spin(lambda: publisher.get_subscription_count()
         and all(map(conditioner.count_subscribers, heard)), conditioner, client)

    def send(images, count):
        for one in images:
            publisher.publish(one)
        spin(lambda: all(len(found) == count for found in heard.values()))
        return heard.values()

    return send


def test_frames_are_conditioned_and_malformed_ones_answered_with_zeros(
    conditioner, client, answers, spin, rng,
):
    reports = []
    client.create_subscription(DiagnosticArray, '/diagnostics', reports.append, 10)
    frames = rng.integers(80, 120, (12, *SHAPE))
    images = [camera_image(frame, 30.0 * k**1.1) for k, frame in enumerate(frames, start=1)]
    first = camera_image(frames[0], 1.0)
    first.encoding = 'rgb8'
    images[8].step = 3
    images[10] = camera_image(frames[10, :, :8], 30.0 * 11**1.1)
    found, *_ = answers([first, *images, images[4]], 12)
    spin(lambda: conditioner.counts['late'] == 1)
    assert [answer.header.stamp for answer in found] == [one.header.stamp for one in images]
    settings = ConditioningSettings()
    state = settings.init(SHAPE)
    for k, answer in enumerate(found):
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


def float_image(frame, stamp_s):
    """Return an image of floats."""
    header = Header(stamp=messages.stamp_from_seconds(stamp_s), frame_id='camera')
    return messages.frame_to_image(frame, header)


def test_pixels_without_a_value_are_no_alarm_and_frames_of_them_are_ignored(
    conditioner, answers, rng,
):
    frames = rng.normal(100.0, 3.0, (14, 40, 48)).astype(np.float32)
    frames[:, :4] = np.nan  # a border
    frames[:, 20:26, 30:36] = np.inf  # a mask
    frames[9:11] = np.nan
    found, *_ = answers([float_image(frame, 1.0 + k) for k, frame in enumerate(frames)], 14)
    cells = np.stack([messages.image_to_frame(answer) for answer in found])
    # What the matched filter takes from beside them is no alarm.
    assert max(abs(cells[:, :2]).max(), abs(cells[:, 10:13, 15:18]).max()) < 3.0
    assert not cells[9:11].any()
    assert 0.7 < cells[11:, 3:, :14].std() < 1.3  # unit noise at once
    assert conditioner.counts['image_raw blank frame'] == conditioner.counts['refused'] == 2


def test_saturated_frame_and_a_cut_are_named(conditioner, answers, rng):
    scenes = [gaussian_scene(rng) for _ in range(2)]
    frames = [scenes[k >= 20] + rng.normal(0.0, 2.0, SCENE) for k in range(30)]
    frames[12] = np.full(SCENE, 255.0)
    reported = []
    conditioner.warn = lambda fault: reported.append((fault.reason, fault.text.split()[1]))
    answers([camera_image(frame, 1.0 + k) for k, frame in enumerate(frames)], 30)
    assert reported == [('saturated frame', '13'), ('cut', '21')]


def gaussian_scene(rng):
    """Return a scene of smooth structures."""
    return 120.0 + 150.0 * scipy.ndimage.gaussian_filter(rng.standard_normal(SCENE), 3.0)


def test_every_frame_has_its_map_and_the_motion_of_the_camera(answers):
    # A texture of two pixels that the camera passes, one pixel a frame; the eleventh is malformed.
    scene = 100.0 + 50.0 * scipy.ndimage.gaussian_filter(
        np.random.default_rng(5).standard_normal((48, 100)), 2.0) * 6.0
    noise = np.random.default_rng(6)
    frames = [scene[:, k:k + 64] + noise.standard_normal((48, 64)) for k in range(24)]
    images = [camera_image(frame, 1.0 + k) for k, frame in enumerate(frames)]
    images[10].step = 3
    cells, maps, motions = answers(images, 24)
    headers = [one.header for one in images]
    assert [one.header for one in maps] == [one.header for one in motions] == headers
    assert {one.child_frame_id for one in motions} == {'camera_scene'}
    assert {one.header.frame_id for one in cells} == {'camera_cells'}
    moved = np.array([info_to_map(one).to_image for one in maps])
    np.testing.assert_array_equal(moved, [
        (one.transform.translation.x, one.transform.translation.y) for one in motions])
    expected = np.stack([-np.arange(24.0), np.zeros(24)], axis=1)
    expected[10] = expected[9]
    assert abs(moved - expected).max() < 0.3
    assert {info_to_map(one).origin for one in maps} > {(0, 0)}  # the cells followed


@pytest.mark.parametrize('conditioner', [1, 2], indirect=True)
def test_restarted_node_begins_another_scene(conditioner, answers):
    _, (info,), _ = answers([camera_image(np.full(SHAPE, 90.0), 5.0)], 1)
    where = info_to_map(info)
    assert where.origin == (0, conditioner.settings.lives * 1_000_000)
    np.testing.assert_allclose(where.pixels(np.zeros(2)), [0.5, 0.5])


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


@pytest.mark.parametrize(('side', 'bytes_waiting'), [(1024, 2**28), (4096, 2**28), (16384, 2**31)])
def test_large_frames_do_not_wait_in_long_queues(context, side, bytes_waiting):
    node = ConditionerNode(context=context, parameter_overrides=[
        Parameter('rows', value=side), Parameter('cols', value=side)])
    node.autostart()
    depth, = (one.qos_profile.depth for one in node.subscriptions if 'image_raw' in one.topic_name)
    node.destroy_node()
    assert depth * 4 * side**2 == bytes_waiting  # of large frames, two
