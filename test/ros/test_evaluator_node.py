# SPDX-License-Identifier: Apache-2.0
"""The evaluator node: restarted chains, messages that it rejects, its own lifecycle."""

import csv
import time

from bringup_end import BringupEnd
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.ros.frame_maps import map_to_info
from lowsnr_common.ros.messages import frame_to_image
from lowsnr_common.ros.messages import stamp_from_seconds
from lowsnr_common.ros.qos import reliable
from lowsnr_common.ros.run_records import ChainCounts
from lowsnr_common.ros.run_records import FrameScored
from lowsnr_common.ros.run_records import NodeRestarted
from lowsnr_eval import evaluator_node
from lowsnr_eval.scene import scene_writer
from lowsnr_eval.scoring.camera_table import read_views
import numpy as np
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2D
from vision_msgs.msg import Detection2DArray
from vision_msgs.msg import ObjectHypothesisWithPose

TOPICS = ('ground_truth', 'detections', 'tracks')
SECOND = 1_000_000_000


@pytest.fixture
def evaluator(context, tmp_path):
    values = {'results': str(tmp_path / 'run'), 'detectors': ['cdt'], 'scenario': 'empty',
              'answer_within_s': 600.0}
    node = evaluator_node.EvaluatorNode(context=context, parameter_overrides=[
        Parameter(name, value=value) for name, value in values.items()])
    node.autostart()
    yield node
    node.destroy_node()


@pytest.fixture
def graph(context, evaluator, spin):
    """Return publishers by topic that reach the evaluator, and the records it has published."""
    node = Node('graph', context=context)
    scored = []
    node.create_subscription(
        DiagnosticArray, 'scored', lambda message: scored.append(
            FrameScored.from_message(message)), reliable(100))
    publishers = {topic: node.create_publisher(Detection2DArray, topic, reliable(100))
                  for topic in TOPICS}
    spin(lambda: evaluator.count_subscribers('scored')
         and all(each.get_subscription_count() for each in publishers.values()), evaluator, node)
    yield publishers, scored
    node.destroy_node()


def array(stamp_s):
    return Detection2DArray(header=Header(stamp=stamp_from_seconds(stamp_s)))


def restart(started_s_ago):
    return NodeRestarted('/cdt_detector', 'was killed', started_s_ago).to_message()


def values(node):
    """Return what a node reports by key."""
    return {item.key: item.value for item in node.health.status('', (), {}).values}


@pytest.fixture
def missing(evaluator, graph, spin):
    """Publish the truth of a frame that no chain has answered."""
    publishers, _ = graph
    publishers['ground_truth'].publish(array(1.0))
    spin(lambda: any(key.startswith('ground_truth median') for key in values(evaluator)))


@pytest.mark.parametrize('started_s_ago', [0.0, 60.0], ids=['before the start', 'during it'])
def test_evaluator_does_not_wait_for_a_frame_that_a_dead_node_missed(
        evaluator, graph, missing, spin, started_s_ago):
    _, scored = graph
    with BringupEnd(evaluator) as bringup:
        bringup.say('restarts', restart(started_s_ago))
        spin(lambda: [record.stamp_ns for record in scored] == [SECOND])


def test_evaluator_waits_for_a_frame_that_a_starting_node_received(
        evaluator, graph, missing, spin, tmp_path, monkeypatch):
    monkeypatch.setattr(evaluator_node, '_CAUGHT_UP_S', 60.0)
    publishers, scored = graph
    with BringupEnd(evaluator) as bringup:
        bringup.say('restarts', restart(60.0))
        with pytest.raises(AssertionError):
            spin(lambda: scored, within=3)
    for topic in TOPICS[1:]:
        publishers[topic].publish(array(1.0))
    spin(lambda: [record.stamp_ns for record in scored] == [SECOND])
    table = tmp_path / 'run' / 'frames.csv'
    spin(lambda: table.read_text().count('1,1.0,cdt,') == 2)
    assert ',,,,,,' not in table.read_text()


def test_stranger_does_not_make_the_evaluator_give_up_an_answer(graph, missing, spin, context):
    _, scored = graph
    stranger = Node('stranger', context=context)
    publisher = stranger.create_publisher(DiagnosticArray, 'restarts', reliable(100))
    publisher.publish(restart(60.0))
    assert not publisher.get_subscription_count()
    with pytest.raises(AssertionError):
        spin(lambda: scored, within=20)
    stranger.destroy_node()


def test_scored_frame_is_announced_with_its_counts(evaluator, graph, spin):
    publishers, scored = graph
    entries = [Detection2D(results=[ObjectHypothesisWithPose()]) for _ in range(3)]
    with BringupEnd(evaluator) as bringup:
        publishers['ground_truth'].publish(array(2.5))
        publishers['detections'].publish(Detection2DArray(
            header=Header(stamp=stamp_from_seconds(2.5)), detections=entries))
        publishers['tracks'].publish(array(2.5))
        spin(lambda: scored)
        told, = bringup.heard('scored', DiagnosticArray)
    assert scored == [FrameScored(2_500_000_000, 1, (ChainCounts('cdt', 3, 0),))]
    assert FrameScored.from_message(told) == scored[0]


@pytest.mark.parametrize(('topic', 'message', 'reason'), [
    ('detections', array(1.0), 'repeated'),
    # A stamp that no message can carry on.
    ('ground_truth', Detection2DArray(
        header=Header(stamp=Time(sec=2**31 - 1, nanosec=2**32 - 1))), 'not a stamp'),
    ('ground_truth', Detection2DArray(header=Header(stamp=Time(sec=-1))), 'not a stamp')])
def test_unsound_message_is_counted_by_its_reason(
        evaluator, graph, missing, spin, topic, message, reason):
    publishers, scored = graph
    for _ in range(2):
        publishers[topic].publish(message)
    spin(lambda: evaluator.counts[f'{topic} {reason}'])
    for answer in TOPICS[1:]:
        publishers[answer].publish(array(1.0))
    spin(lambda: [record.stamp_ns for record in scored] == [SECOND])


def test_array_of_a_scored_frame_is_counted_as_late(evaluator, graph, spin):
    publishers, scored = graph
    for topic in TOPICS:
        publishers[topic].publish(array(1.0))
    spin(lambda: scored)
    publishers['tracks'].publish(array(1.0))
    spin(lambda: evaluator.counts['tracks late'])
    assert evaluator.counts['late'] == 1


def test_evaluator_that_is_configured_again_continues_its_table(evaluator, graph, spin, tmp_path):
    publishers, scored = graph
    for topic in TOPICS:
        publishers[topic].publish(array(1.0))
    spin(lambda: scored)
    for transition in ('deactivate', 'cleanup', 'configure', 'activate'):
        getattr(evaluator, f'trigger_{transition}')()
    spin(lambda: all(each.get_subscription_count() for each in publishers.values()))
    for topic in TOPICS:
        publishers[topic].publish(array(2.0))
    spin(lambda: len(scored) == 2)
    rows = (tmp_path / 'run' / 'frames.csv').read_text().splitlines()
    assert [row.split(',')[0] for row in rows[1:]] == ['1', '1', '2', '2']


@pytest.mark.parametrize('conditioned', [False, True])
def test_evaluator_whose_scene_is_full_takes_no_more_frames(
        context, spin, tmp_path, monkeypatch, conditioned):
    monkeypatch.setattr(scene_writer, 'BUDGET', 10)
    node = evaluator_node.EvaluatorNode(context=context, parameter_overrides=[
        Parameter(name, value=value) for name, value in {
            'results': str(tmp_path), 'detectors': ['cdt'], 'conditioned': conditioned}.items()])
    node.autostart()
    other = Node('other', context=context)
    frames = [other.create_publisher(Image, topic, 10) for topic in (
        'image_raw', 'conditioned/image_raw')[:1 + conditioned]]
    arrays = [other.create_publisher(Detection2DArray, topic, 10) for topic in TOPICS]
    maps = other.create_publisher(CameraInfo, 'camera_info', 10)
    wanted = frames + arrays + [maps] * conditioned
    spin(lambda: all(each.get_subscription_count() for each in wanted), node, other)
    last = scene_writer.WAITING + 2  # answers wait so long for frames, which do not come
    for stamp_s in range(1, last):
        for topic in arrays:
            topic.publish(array(stamp_s))
    spin(lambda: not any(each.get_subscription_count() for each in frames), node, other)
    if conditioned:  # maps are kept for the paths of tracks to the end
        maps.publish(map_to_info(FrameMap('c', (8, 6), 2, (1, 2), (3.5, -1.25)), array(7).header))
        spin(lambda: read_views(tmp_path) == {7_000_000_000: (2, 3.5, -1.25)})
    for topic in arrays:
        topic.publish(array(last))
    spin(lambda: node.counts['in'] == last)
    node.report()
    assert not any(key.startswith('fault') for key in values(node))
    node.on_cleanup(None)
    other.destroy_node()
    node.destroy_node()


def test_latencies_without_truth_begin_when_a_frame_arrives(context, spin, tmp_path):
    node = evaluator_node.EvaluatorNode(context=context, parameter_overrides=[
        Parameter(name, value=value) for name, value in {
            'results': str(tmp_path), 'detectors': ['hmm', 'cusum'], 'namespaces': True,
            'truth': False, 'lags': [1, 0], 'operating_points': ['matched'] * 2}.items()])
    assert node.autostart()
    other = Node('other', context=context)
    frames = other.create_publisher(Image, 'image_raw', 10)
    arrays = {chain: [other.create_publisher(Detection2DArray, f'{chain}/{topic}', 10)
                      for topic in TOPICS[1:]] for chain in ('hmm', 'cusum')}
    spin(lambda: all(each.get_subscription_count()
                     for each in (frames, *arrays['hmm'], *arrays['cusum'])), node, other)
    sent_s = {}
    for k in (1, 2):
        frames.publish(frame_to_image(np.zeros((2, 3)), array(k).header))
        spin(lambda number=k: len(node._scorer._arrived_s) == number)
        sent_s[k] = time.monotonic()
        for each in arrays['cusum'] + arrays['hmm'] * (k - 1):
            each.publish(array(k - (each in arrays['hmm'])))
    spin(lambda: node.counts['in'] == 1)
    node.on_deactivate(None)
    with (tmp_path / 'latency.csv').open(newline='') as file:
        found = {row['detector']: float(row['detection_ms']) for row in csv.DictReader(file)}
    assert found['cusum'] > 0.0
    assert found['hmm'] > max(found['cusum'], 1e3 * (sent_s[2] - sent_s[1]))
    node.destroy_node()
    other.destroy_node()
