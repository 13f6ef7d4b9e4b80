# SPDX-License-Identifier: Apache-2.0
"""Maps of conditioned frames as messages, and the nodes that work with them."""

from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Malformed
from lowsnr_common.ros import messages
from lowsnr_common.ros.frame_maps import info_to_map
from lowsnr_common.ros.frame_maps import map_to_info
from lowsnr_detect.node.detector_node import DetectorNode
from lowsnr_track.tracker_node import TrackerNode
import numpy as np
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray

DEPTH = QoSProfile(depth=1000)
SHAPE = (20, 30)  # of the cells


def header(stamp_s, frame_id='camera'):
    return Header(stamp=messages.stamp_from_seconds(stamp_s), frame_id=frame_id)


def mapped(origin=(0, 0), to_image=(0.0, 0.0), binning=2):
    return FrameMap(
        'camera', (binning * SHAPE[1], binning * SHAPE[0]), binning, origin, to_image)


@pytest.mark.parametrize('binning', [1, 2])
def test_projections_lead_from_the_scene_to_the_image_and_to_cells(binning):
    where = mapped((-12, 7), (31.25, -4.5), binning)
    info = map_to_info(where, header(3.0))
    assert info_to_map(info) == where
    scene = np.array([5.0, -9.0, 1.0])
    pixel, cell = info.k.reshape(3, 3) @ scene, info.p.reshape(3, 4) @ [*scene, 1.0]
    assert (pixel[2], cell[2]) == (1.0, 1.0)
    np.testing.assert_allclose(where.pixels(cell[:2]), pixel[:2], rtol=1e-12)
    assert (info.width, info.height, info.binning_x) == (30 * binning, 20 * binning, binning)


@pytest.mark.parametrize(('field', 'value'), [
    ('binning_x', 0), ('binning_x', 4_000_000_000), ('width', 0), ('k', np.full(9, np.nan)),
    ('p', np.full(12, np.inf))])
def test_projection_that_is_no_map_is_rejected(field, value):
    info = map_to_info(mapped(), header(1.0))
    setattr(info, field, value)
    with pytest.raises(Malformed) as caught:
        info_to_map(info)
    assert caught.value.reason == 'no map of a frame'


@pytest.fixture
def client(context):
    node = Node('client', context=context)
    yield node
    node.destroy_node()


@pytest.fixture
def node(context, request):
    """Return a started node that waits for maps."""
    make, values = request.param
    made = make(context=context, parameter_overrides=[
        Parameter(name, value=value) for name, value in (values | {'conditioned': True}).items()])
    made.autostart()
    yield made
    made.destroy_node()


def connected(node, client, spin, kind, topic, answer):
    """Return publishers of maps and of a topic, and the list of the answers to it."""
    answers = []
    client.create_subscription(Detection2DArray, answer, answers.append, DEPTH)
    maps = client.create_publisher(CameraInfo, 'camera_info', DEPTH)
    publisher = client.create_publisher(kind, topic, DEPTH)
    spin(lambda: maps.get_subscription_count() and publisher.get_subscription_count()
         and node.count_subscribers(answer), node, client)
    return maps.publish, publisher.publish, answers


CDT = (lambda **kw: DetectorNode('cdt', **kw), {
    'operating_point': 'manual', 'threshold': 20.0, 'sensor.snr_db': 20.0})
TRACKER = (TrackerNode, {'rows': SHAPE[0], 'cols': SHAPE[1]})


@pytest.mark.parametrize('node', [CDT], indirect=True)
def test_detections_are_in_pixels_of_the_image_whatever_arrives_first(node, client, spin):
    send_map, send_frame, answers = connected(
        node, client, spin, Image, 'image_raw', 'detections')
    frame = np.zeros(SHAPE)
    frame[4, 3] = 10.0
    images = [messages.frame_to_image(frame, header(k, 'camera_cells')) for k in range(1, 5)]
    maps = [mapped((2, 8), (0.5 * k, -10.0)) for k in range(1, 5)]
    send_map(map_to_info(maps[0], header(1.0)))
    for image in images[:3]:  # the second never gets its map
        send_frame(image)
    spin(lambda: len(answers) == 1)
    send_map(map_to_info(maps[2], header(3.0)))
    spin(lambda: len(answers) == 2)
    send_frame(images[3])
    send_map(map_to_info(maps[3], header(4.0)))
    spin(lambda: len(answers) == 3)
    assert [answer.header for answer in answers] == [header(k) for k in (1.0, 3.0, 4.0)]
    # Cell (3, 4) is (5, 12) of the scene, whose centre is at 10.5, 24.5.
    places = [answer.detections[0].bbox.center.position for answer in answers]
    assert [(place.x, place.y) for place in places] == [(11.0, 14.5), (12.0, 14.5), (12.5, 14.5)]
    counts = dict(node.counts)
    assert (counts['in'], counts['out'], counts['refused']) == (4, 3, 1)


HMM_LAG = (lambda **kw: DetectorNode('hmm', **kw), {
    'operating_point': 'manual', 'threshold': -5.0, 'sensor.snr_db': 20.0, 'lag': 2})


@pytest.mark.parametrize('node', [HMM_LAG], indirect=True)
def test_late_detections_are_in_pixels_of_the_frame_that_they_are_about(node, client, spin):
    send_map, send_frame, answers = connected(
        node, client, spin, Image, 'image_raw', 'detections')
    # An object at rest in the scene, the cells follow the camera, and the last frame is a cut.
    origins = [(0, 0), (0, 0), (2, -1), (2, -1), (5, -3), (5 + SHAPE[1], 0)]
    maps = [mapped(origin, (-1.5 * k, 2.5 * k)) for k, origin in enumerate(origins)]
    scene = np.array([11, 7])
    for k, where in enumerate(maps, start=1):
        frame = np.zeros(SHAPE)
        if k < len(maps):
            frame[tuple(np.subtract(scene, where.origin)[::-1])] = 10.0
        send_map(map_to_info(where, header(k)))
        send_frame(messages.frame_to_image(frame, header(k, 'camera_cells')))
    spin(lambda: len(answers) == 5)
    assert [answer.header for answer in answers] == [header(k) for k in range(1, 6)]
    for answer, where in zip(answers, maps):
        place = answer.detections[0].bbox.center.position
        expected = where.pixels(np.subtract(scene, where.origin))
        assert (place.x, place.y) == pytest.approx(tuple(expected), abs=0.1)


def test_without_a_conditioner_no_map_is_waited_for(context, client, spin):
    made = DetectorNode('cdt', context=context, parameter_overrides=[
        Parameter(name, value=value) for name, value in CDT[1].items()])
    made.autostart()
    assert not made.count_subscribers('camera_info')
    made.destroy_node()


@pytest.mark.parametrize('node', [TRACKER], indirect=True)
def test_track_stands_still_in_the_scene_while_the_camera_moves(node, client, spin):
    send_map, send, answers = connected(
        node, client, spin, Detection2DArray, 'detections', 'tracks')
    scene, expected = np.array([40.5, 30.5]), []
    for k in range(1, 21):
        column = 4 * (k // 4)  # the cells follow the camera in steps
        where = mapped((column, 0), (-2.3 * k, 0.0))
        if k == 20:
            where = mapped((column, SHAPE[0]), (-2.3 * k, -2.0 * SHAPE[0]))
        expected.append(scene + where.to_image)
        item = Estimate(np.array([
            expected[-1][0], np.nan, expected[-1][1], np.nan]), np.eye(4), 0.99)
        send_map(map_to_info(where, header(k)))
        send(messages.estimates_to_array([item] if k < 20 else [], header(k), 1.0))
    spin(lambda: len(answers) == 20)
    found = {k: item for k, answer in enumerate(answers) for item in answer.detections}
    assert set(range(8, 19)) <= set(found)
    assert len({item.id for item in found.values()}) == 1
    for k, item in found.items():
        place = item.bbox.center.position
        assert abs(np.array([place.x, place.y]) - expected[k]).max() < 1.0
    assert not answers[19].detections  # after the cut
