# SPDX-License-Identifier: Apache-2.0
"""The tracker node answers every array once, and counts the detections it rejects."""

from diagnostic_msgs.msg import DiagnosticArray
from lowsnr_common.core import compiled
from lowsnr_common.core.records import Estimate
from lowsnr_common.ros import messages
from lowsnr_track import measurements
from lowsnr_track.pda_mmpf import PdaMmpf
from lowsnr_track.tracker_node import TrackerNode
from lowsnr_track.tracker_node import warm_up
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray

DEPTH = QoSProfile(depth=1000)


@pytest.fixture
def tracker(context):
    values = {'rows': 16, 'cols': 24}
    node = TrackerNode(context=context, parameter_overrides=[
        Parameter(name, value=value) for name, value in values.items()])
    node.autostart()
    yield node
    node.destroy_node()


@pytest.fixture
def client(context):
    node = Node('client', context=context)
    yield node
    node.destroy_node()


@pytest.fixture
def answers(tracker, client, spin):
    """Return a function that sends arrays and returns tracks, odometry and last diagnostics."""
    tracks, states, reports = [], [], []
    client.create_subscription(Detection2DArray, 'tracks', tracks.append, DEPTH)
    client.create_subscription(Odometry, 'tracks/odometry', states.append, DEPTH)
    client.create_subscription(DiagnosticArray, '/diagnostics', reports.append, DEPTH)
    publisher = client.create_publisher(Detection2DArray, 'detections', DEPTH)
    spin(lambda: publisher.get_subscription_count() and tracker.count_subscribers('tracks')
         and tracker.count_subscribers('tracks/odometry'), tracker, client)

    def send(*arrays):
        wanted = tracker.counts['out'] + tracker.counts['late'] + len(arrays)
        for array in arrays:
            publisher.publish(array)
        spin(lambda: tracker.counts['out'] + tracker.counts['late'] == wanted
             and len(tracks) == tracker.counts['out'])
        tracker.report()
        spin(lambda: counts(reports) == dict(tracker.counts))
        return tracks, states, counts(reports)

    return send


def counts(reports):
    """Return the counters of the last report of the tracker."""
    values = [status.values for report in reports for status in report.status][-1:]
    return {
        item.key: int(item.value) for items in values for item in items
        if item.value.isdigit() and item.key != 'process'}


def array(stamp_s, *places, score=0.9):
    """Return an array of detections at places (x, y)."""
    header = Header(stamp=messages.stamp_from_seconds(stamp_s), frame_id='sensor')
    found = [Estimate(np.array([x, 0.0, y, 0.0]), 0.3 * np.eye(4), score) for x, y in places]
    return messages.estimates_to_array(found, header, 1.0)


def test_every_array_is_answered_with_states_of_the_same_ids(answers):
    sent = [array(k, (4 + 0.5 * k, 6)) for k in range(1, 11)]
    tracks, states, status = answers(*sent)
    assert [answer.header for answer in tracks] == [message.header for message in sent]
    ids = [item.id for answer in tracks for item in answer.detections]
    assert ids == [state.child_frame_id for state in states]
    assert len(ids) >= 5
    assert set(ids) == {'1'}
    assert (status['in'], status['out']) == (10, 10)


def test_time_of_a_step_is_in_the_diagnostics(answers, tracker, client, spin):
    reports = []
    client.create_subscription(DiagnosticArray, '/diagnostics', reports.append, DEPTH)
    answers(array(1, (4, 6)), array(2, (4, 6)))

    def said():
        return {v.key: v.value for r in reports for s in r.status for v in s.values}

    spin(lambda: 'detections median [ms]' in said())
    assert 0.0 < float(said()['detections median [ms]']) <= float(
        said()['detections longest [ms]'])


def test_unusable_detections_are_counted_and_the_track_continues(answers):
    path = [array(k, (4 + 0.5 * k, 6)) for k in range(1, 9)]
    broken = array(9, (8.5, 6), (np.nan, 6), (8.5, 6), (99, 6), (5, 5))
    broken.detections[-1].results[0].hypothesis.score = 7.0
    tracks, _, status = answers(*path, path[3], path[-1], broken, array(10, (9, 6)))
    assert len(tracks) == 10
    assert status['late'] == 2
    assert {key: count for key, count in status.items() if key.startswith('detections')} == {
        f'detections {reason}': 1 for reason in (
            measurements.NOT_FINITE, measurements.NO_SCORE, measurements.OUTSIDE,
            measurements.DUPLICATE)}
    assert [item.id for item in tracks[-1].detections] == ['1']


def test_jump_of_the_stamps_deletes_all_tracks(answers):
    path = [array(k, (4 + 0.5 * k, 6)) for k in range(1, 9)]
    tracks, _, _ = answers(*path, array(1e6, (8.5, 6)))
    assert tracks[-2].detections
    assert not tracks[-1].detections


def test_flood_of_detections_is_answered(answers):
    rng = np.random.default_rng(1)
    places = rng.uniform([0, 0], [23, 15], (10_000, 2))
    tracks, _, status = answers(array(1, *places), array(2, *places[::-1]), array(3))
    assert len(tracks) == 3
    assert status['in'] == 3
    assert all(len(answer.detections) <= 50 for answer in tracks)


def test_warm_up_compiles_everything(rng):
    tracker = PdaMmpf(rows=16, cols=24, particles=4000)
    warm_up(tracker)
    before, state = compiled.variants(), tracker.init()
    for k in range(1, 9):
        found = [Estimate(np.array([x, 0.0, 6.0, 0.0]), 0.3 * np.eye(4), 0.9)
                 for x in (4.0 + 0.5 * k, 3.0)]
        state, _ = tracker.step(state, found, float(k), rng)
    assert compiled.variants() == before > 0
