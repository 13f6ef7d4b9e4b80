# SPDX-License-Identifier: Apache-2.0
"""The detector node publishes one array for every frame, an empty one for a malformed frame."""

from bringup_end import BringupEnd
from diagnostic_msgs.msg import DiagnosticArray
from lowsnr_common.core.records import AlarmRate
from lowsnr_common.ros import messages
from lowsnr_common.ros.bringup_line import LAST_FRAME
from lowsnr_common.ros.run_records import ALARM_RATE
from lowsnr_common.ros.run_records import rate_from_message
from lowsnr_detect.node.detector_node import DetectorNode
import numpy as np
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray

SHAPE = (7, 5)
BRIGHT = (4, 3)


@pytest.fixture
def detector(context):
    values = {'operating_point': 'manual', 'threshold': 20.0, 'rows': SHAPE[0], 'cols': SHAPE[1],
              'sensor.snr_db': 20.0}
    node = DetectorNode('cdt', context=context, parameter_overrides=[
        Parameter(name, value=value) for name, value in values.items()])
    node.autostart()
    yield node
    node.destroy_node()


@pytest.fixture
def client(context):
    node = Node('client', context=context)
    yield node
    node.destroy_node()


def bright_frame(stamp_s, shape=SHAPE):
    """Return an image with one bright cell."""
    frame = np.zeros(shape)
    frame[BRIGHT] = 10.0
    header = Header(stamp=messages.stamp_from_seconds(stamp_s), frame_id='sensor')
    return messages.frame_to_image(frame, header)


def test_every_frame_gets_one_array_and_a_malformed_one_an_empty_array(detector, client, spin):
    answers, reports = [], []
    client.create_subscription(Detection2DArray, 'detections', answers.append, 10)
    client.create_subscription(DiagnosticArray, '/diagnostics', reports.append, 10)
    frames = client.create_publisher(Image, 'image_raw', 10)
    spin(lambda: frames.get_subscription_count() and detector.count_subscribers('detections'),
         detector, client)
    images = [bright_frame(k) for k in range(1, 8)]
    images[1].encoding = 'mono8'
    images[2].step = 3
    images[3].height = 99
    images[4] = bright_frame(5, shape=(6, 5))
    images[5] = messages.frame_to_image(np.full(SHAPE, np.nan), images[5].header)
    for image in [*images, images[6], bright_frame(3)]:
        frames.publish(image)
    spin(lambda: len(answers) == 7 and detector.counts['late'] == 2)
    assert [len(answer.detections) for answer in answers] == [1, 0, 0, 0, 0, 0, 1]
    assert [answer.header for answer in answers] == [image.header for image in images]
    centre = answers[0].detections[0].bbox.center.position
    assert (centre.x, centre.y) == BRIGHT[::-1]
    assert 0.5 < answers[0].detections[0].results[0].hypothesis.score <= 1.0
    spin(lambda: any(counts(r).get('refused') == '7' for r in reports))
    assert detector.counts['in'] == detector.counts['out'] == 7


def test_statistic_is_published_on_request_with_the_header_of_its_frame(context, client, spin):
    """CDT, eq. (4): I z - I^2 / 2 with I = 10 at 20 dB, minus the threshold of 20."""
    node = DetectorNode('cdt', context=context, parameter_overrides=[
        Parameter(name, value=value) for name, value in {
            'operating_point': 'manual', 'threshold': 20.0, 'sensor.snr_db': 20.0,
            'statistic_map': True}.items()])
    node.autostart()
    maps = []
    client.create_subscription(Image, 'statistic', maps.append, 10)
    frames = client.create_publisher(Image, 'image_raw', 10)
    spin(lambda: frames.get_subscription_count() and node.count_subscribers('statistic'),
         node, client)
    images = [bright_frame(1), bright_frame(2), bright_frame(3)]
    images[1].encoding = 'mono8'  # it is rejected, and has no statistic
    for image in images:
        frames.publish(image)
    spin(lambda: len(maps) == 2)
    assert [each.header for each in maps] == [images[0].header, images[2].header]
    plane = messages.image_to_frame(maps[1])
    assert plane.shape == SHAPE
    assert plane[BRIGHT] == pytest.approx(100.0 - 50.0 - 20.0)
    assert plane[0, 0] == pytest.approx(-50.0 - 20.0)
    node.destroy_node()


def test_statistic_is_not_published_unless_asked_for(detector, client, spin):
    spin(lambda: client.count_publishers('detections'), detector, client)
    assert not client.count_publishers('statistic')


def test_late_answers_have_the_headers_of_their_frames_and_the_last_ones_come_at_the_end(
    context, client, spin,
):
    node = DetectorNode('hmm', context=context, parameter_overrides=[
        Parameter(name, value=value) for name, value in {
            'operating_point': 'manual', 'threshold': 0.0, 'sensor.snr_db': 20.0,
            'lag': 2}.items()])
    node.autostart()
    answers = []
    client.create_subscription(Detection2DArray, 'detections', answers.append, 10)
    frames = client.create_publisher(Image, 'image_raw', 10)
    spin(lambda: frames.get_subscription_count() and node.count_subscribers('detections'),
         node, client)
    images = [bright_frame(k) for k in range(1, 8)]
    images[0].encoding = images[3].encoding = 'mono8'
    # The object is in the second frame alone; the fourth is rejected, and the lag skips it.
    for k in (2, 4, 5, 6):
        images[k].data = messages.frame_to_image(np.zeros(SHAPE), images[k].header).data
    with BringupEnd(node) as bringup:
        for image, answered in zip(images, (1, 1, 1, 1, 2, 4, 5), strict=True):
            frames.publish(image)
            spin(lambda answered=answered, image=image: len(answers) == answered
                 and node._newest_ns == messages.stamp_key(image.header.stamp))
        bringup.say(LAST_FRAME, Clock(clock=images[-1].header.stamp))
        spin(lambda: len(answers) == 7)
    assert [answer.header for answer in answers] == [image.header for image in images]
    assert [len(answer.detections) for answer in answers] == [0, 1, 0, 0, 0, 0, 0]
    assert node.counts['out'] == 7
    assert node.facts()['lag [frames]'] == '2'
    node.destroy_node()


def test_frame_that_comes_after_the_word_that_it_is_the_last_is_waited_for(
    context, client, spin,
):
    node = DetectorNode('hmm', context=context, parameter_overrides=[
        Parameter('operating_point', value='nominal'), Parameter('lag', value=5)])
    node.autostart()
    answers = []
    client.create_subscription(Detection2DArray, 'detections', answers.append, 10)
    frames = client.create_publisher(Image, 'image_raw', 10)
    spin(lambda: frames.get_subscription_count() and node.count_subscribers('detections'),
         node, client)
    with BringupEnd(node) as bringup:
        bringup.say(LAST_FRAME, Clock(clock=messages.stamp_from_seconds(2)))
        spin(lambda: node._last_ns is not None)
        frames.publish(bright_frame(1))
        spin(lambda: node.counts['in'] == 1)
        assert not node.counts['out']
        frames.publish(bright_frame(2))
        spin(lambda: len(answers) == 2)
    node.destroy_node()


def test_change_that_empties_the_memory_answers_the_frames_before_it(started):
    client = started(DetectorNode, 'hmm', operating_point='manual', threshold=0.0, lag=2,
                     rows=SHAPE[0], cols=SHAPE[1], sensor__snr_db=20.0)
    client.spin(lambda: client.frames.get_subscription_count()
                and client.node.count_subscribers('detections'))
    for k in (1, 2):
        client.frames.publish(bright_frame(k))
    client.spin(lambda: client.node.counts['in'] == 2)
    assert client.set('sensor.snr_db', 10.0).successful
    client.spin(lambda: len(client.answers) == 2)
    for k in (3, 4, 5):
        client.frames.publish(bright_frame(k))
    client.spin(lambda: len(client.answers) == 3)
    assert [answer.header.stamp.sec for answer in client.answers] == [1, 2, 3]
    assert all(answer.detections for answer in client.answers)


def counts(report):
    """Return the counters of a report."""
    return {item.key: item.value for item in report.status[0].values}


def test_type_hash_is_the_one_of_every_jazzy(detector, client, spin):
    spin(lambda: client.get_publishers_info_by_topic('detections'), detector, client)
    info = client.get_publishers_info_by_topic('detections')[0]
    digest = bytes(info.topic_type_hash.value).hex()
    assert info.topic_type == 'vision_msgs/msg/Detection2DArray'
    assert digest == '214274120007f4a683866481336b70310268cfa107aebe9d594a6acf75bda968'


@pytest.mark.parametrize(('point', 'keys'), [
    ('adaptive', ['asked', 'measured']), ('manual', [])])
def test_false_alarm_rate_asked_and_measured_goes_to_diagnostics_and_bringup(
        context, point, keys):
    node = DetectorNode('cdt', context=context, parameter_overrides=[
        Parameter(name, value=value) for name, value in {
            'operating_point': point, 'rows': 40, 'cols': 40, 'false_alarm_prob': 0.05}.items()])
    try:
        with BringupEnd(node) as end:
            node.autostart()
            node.report()
            said = end.heard(ALARM_RATE, DiagnosticArray)[-1]
        assert sorted(node.facts()) == [f'false_alarm_prob {key}' for key in keys]
        assert rate_from_message(said) == ('/cdt_detector', AlarmRate(0.05, 0.0) if keys
                                           else AlarmRate())
    finally:
        node.destroy_node()
