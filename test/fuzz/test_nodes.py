# SPDX-License-Identifier: Apache-2.0
"""No message stops a node, raises in it or makes it grow."""

from collections import Counter
from functools import partial
import gc
from inspect import signature
import os
from pathlib import Path

from fuzz.counting import fuzz
from fuzz.messages import arrays
from fuzz.messages import images
from fuzz.messages import odometries
from fuzz.messages import projections
from fuzz.messages import records
from fuzz.messages import stamped
from fuzz.messages import steps_ns
from graph_runs import ROOT
from hypothesis import given
from hypothesis import settings
from hypothesis import strategies as st
from lowsnr_common.ros.messages import frame_to_image
from lowsnr_common.ros.messages import stamp_key
from lowsnr_detect.node.detector_node import DetectorNode
from lowsnr_eval.evaluator_node import EvaluatorNode
from lowsnr_eval.viewer_node import ViewerNode
from lowsnr_sensor.conditioner_node import ConditionerNode
from lowsnr_sensor.sensor_node import SensorNode
from lowsnr_track.tracker_node import TrackerNode
import numpy as np
import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from rclpy.serialization import serialize_message
from ros_nodes import node_domain
from ros_nodes import ros_context
from tally import INPUTS
from vision_msgs.msg import Detection2D
from vision_msgs.msg import Detection2DArray
from vision_msgs.msg import ObjectHypothesisWithPose

pytestmark = pytest.mark.filterwarnings('ignore::RuntimeWarning')
NANO = 1_000_000_000


class Feed:
    """Hand messages to the callbacks of a node as the middleware does."""

    def __init__(self, node):
        self.node, self.stamp_ns = node, NANO
        self.callbacks = {item.topic_name.strip('/'): item.callback for item in node.subscriptions}
        self.sent = Counter()

    def __call__(self, step_ns, topic, message):
        stamp_ns = self.stamp_ns + step_ns
        self.stamp_ns = stamp_ns if 0 < stamp_ns < 2**60 else self.stamp_ns + NANO
        message.header = stamped(min(max(stamp_ns, -2**31 * NANO), 2**31 * NANO - 1))
        # As in the middleware, a message holds only numbers of its own types.
        message = deserialize_message(serialize_message(message), type(message))
        callback = self.callbacks[topic]
        self.sent[topic] += 1
        info = {'publication_sequence_number': self.sent[topic]}
        callback(*(message, info)[:len(signature(callback).parameters)])


@pytest.fixture
def feed(request, place):
    """Return the feed of the node that the test names; all of its inputs share it."""
    make, values = NODES[request.param]
    with ros_context(node_domain()) as context:
        node = make(context=context, parameter_overrides=[
            Parameter(name, value=value) for name, value in values.items()] + (
            [Parameter('results', value=str(place))] if request.param == 'evaluator' else []))
        assert node.autostart()
        yield Feed(node)
        node.destroy_node()


DETECTORS = ('cdt', 'sdt', 'tbd1', 'mmtbd2', 'hmm', 'cusum')
SMALL = {'rows': 4, 'cols': 5, 'operating_point': 'nominal'}
FEW = {'tbd1': {'particles': 200}, 'mmtbd2': {'particles': 200}}
TRACKER = {'rows': 16, 'cols': 24, 'particles': 50}
NODES = {name: (partial(DetectorNode, name), SMALL | FEW.get(name, {})) for name in DETECTORS} | {
    'conditioner': (ConditionerNode, {}), 'viewer': (ViewerNode, {'side': 40}),
    'tracker': (TrackerNode, TRACKER), 'mapped': (TrackerNode, TRACKER | {'conditioned': True}),
    'mapped bank': (partial(DetectorNode, 'bank'), SMALL | {'conditioned': True}),
    'evaluator': (EvaluatorNode, {'detectors': ['sdt'], 'scenario': 's', 'conditioned': True}),
    'sensor': (SensorNode, {
        'scenario': str(ROOT / 'config' / 'scenarios' / 'example1.yaml'), 'lockstep': True,
        'loop': True})}
TOPICS = {
    'conditioner': ('image_raw',), 'tracker': ('detections',), 'sensor': ('scored',),
    'mapped': ('camera_info', 'detections'), 'mapped bank': ('camera_info', 'image_raw'),
    'viewer': ('image_raw', 'ground_truth', 'detections', 'tracks', 'tracks/odometry'),
    'evaluator': ('image_raw', 'conditioned/image_raw', 'camera_info', 'ground_truth',
                  'ground_truth/odometry', 'detections', 'detections/odometry', 'tracks',
                  'tracks/odometry')}
ALL_TOPICS = {topic for topics in TOPICS.values() for topic in topics}
small_images = images() | st.builds(
    lambda cells, seed: frame_to_image(
        cells * np.random.default_rng(seed).standard_normal((4, 5)), stamped(0)),
    st.sampled_from([1.0, 1e-30, 1e20, 1e38]), st.integers(0, 99))


def message(topic):
    """Return the strategy of the messages of a topic."""
    if topic.endswith('image_raw'):
        return small_images
    if topic == 'scored':
        return records()
    if topic == 'camera_info':
        return projections()
    return odometries() if topic.endswith('odometry') else arrays()


def sequences(*topics):
    """Return a strategy of a few triples of step [ns], topic and message."""
    return st.lists(st.sampled_from(topics).flatmap(
        lambda topic: st.tuples(steps_ns, st.just(topic), message(topic))), min_size=1, max_size=4)


@pytest.mark.parametrize('feed', DETECTORS, indirect=True)
@fuzz('images to detectors', 72, sent=sequences('image_raw'))
def test_detector_answers_every_frame(feed, sent):
    for each in sent:
        feed(*each)
    assert feed.node.counts['in'] == feed.node.counts['out']


@pytest.mark.parametrize('feed', ['conditioner'], indirect=True)
@fuzz('messages to the conditioner', 180, sent=sequences(*TOPICS['conditioner']))
def test_conditioner_goes_on(feed, sent):
    for each in sent:
        feed(*each)


@pytest.mark.parametrize('feed', ['tracker'], indirect=True)
@fuzz('messages to the tracker', 180, sent=sequences(*TOPICS['tracker']))
def test_tracker_answers_every_array(feed, sent):
    for each in sent:
        feed(*each)


@pytest.mark.parametrize('feed', ['mapped', 'mapped bank'], indirect=True)
@fuzz('maps of frames', 90, sent=st.lists(projections(), min_size=1, max_size=4))
def test_frames_with_a_sound_map_are_answered(feed, sent):
    counts = feed.node.counts
    for info in sent:
        refused, answered = counts['refused'], counts['out']
        feed(NANO, 'camera_info', info)
        sound = counts['refused'] == refused
        if 'image_raw' in feed.callbacks:
            feed(0, 'image_raw', frame_to_image(np.ones((4, 5)), stamped(0)))
        else:
            feed(0, 'detections', Detection2DArray(detections=[Detection2D()]))
        assert counts['out'] == answered + sound


@pytest.mark.parametrize('feed', ['viewer'], indirect=True)
@fuzz('messages to the viewer', 180, sent=sequences(*TOPICS['viewer']))
def test_viewer_goes_on(feed, sent):
    for each in sent:
        feed(*each)


@pytest.mark.parametrize('feed', ['evaluator'], indirect=True)
@fuzz('messages to the evaluator', 180, sent=sequences(*TOPICS['evaluator']))
def test_evaluator_goes_on(feed, sent):
    for each in sent:
        feed(*each)
    feed.node.trigger_deactivate()
    feed.node.trigger_activate()


@pytest.mark.parametrize('feed', ['sensor'], indirect=True)
@fuzz('messages to the sensor', 720, sent=sequences(*TOPICS['sensor']))
def test_sensor_sends_a_frame_for_each_sound_record_of_the_last_alone(feed, sent):
    if not feed.node.counts['out']:
        executor = SingleThreadedExecutor(context=feed.node.context)
        executor.add_node(feed.node)
        while not feed.node.counts['out']:
            executor.spin_once()
        executor.remove_node(feed.node)
    for each in sent:
        newest, refused = feed.node.counts['out'], feed.node.counts['refused']
        feed.stamp_ns = (newest - 1) * NANO
        feed(*each)
        awaited = stamp_key(each[2].header.stamp) == newest * NANO
        sound = feed.node.counts['refused'] == refused
        assert feed.node.counts['out'] == newest + (awaited and sound)


@pytest.mark.parametrize('feed', ['tracker', 'viewer', 'evaluator'], indirect=True)
def test_ten_thousand_entries_of_extreme_numbers_end_nothing(feed):
    item = Detection2D(id='<b>&lt;\x1b[2J', results=[ObjectHypothesisWithPose()])
    item.bbox.center.position.x, item.bbox.center.position.y = 1e-320, 3.0
    item.results[0].hypothesis.score = 5e-324
    item.results[0].pose.covariance = np.full(36, 1e308)
    for topic in TOPICS[feed.node.get_name()]:
        if not topic.endswith(('odometry', 'raw', 'info')):
            feed(NANO, topic, Detection2DArray(detections=[item] * 10_000))
            INPUTS['arrays of 10,000'] += 1


def drawn(topic):
    """Return messages of a topic, the same ones every time."""
    found = []

    @settings(max_examples=60)
    @given(message(topic))
    def collect(item):
        if len(getattr(item, 'detections', ())) < 50:  # thousands take their time
            found.append(item)

    collect()
    return found


def resident_bytes():
    """Return the resident memory of this process [bytes]."""
    gc.collect()
    return int(Path('/proc/self/statm').read_text().split()[1]) * os.sysconf('SC_PAGE_SIZE')


@pytest.mark.parametrize('feed', ['sdt', *TOPICS], indirect=True)
def test_nodes_do_not_grow(feed, rng):
    sent = {topic: drawn(topic) for topic in feed.callbacks if topic in ALL_TOPICS}

    def send(count):
        start = resident_bytes()
        for _ in range(count):
            topic = rng.choice(sorted(sent))
            feed(NANO // 10, topic, sent[topic][rng.integers(len(sent[topic]))])
        INPUTS['messages against growth'] += count
        return resident_bytes() - start

    warm_up = send(500)
    # A node that keeps more than 6 kB of every message would fail.
    assert send(700) <= max(warm_up, 0) + 2**22
