# SPDX-License-Identifier: Apache-2.0
"""Frames are joined whatever the order of their messages, and given up in time."""

from itertools import permutations

from lowsnr_common.core.records import Estimate
from lowsnr_eval.scoring.frame_join import Arrival
from lowsnr_eval.scoring.frame_join import FrameJoin
import numpy as np
import pytest

TOPICS = ('truth', 'tracks')


def entry(name='', velocity=np.nan):
    """Return an entry of an array, or, with a velocity, a state."""
    return Estimate(np.array([1.0, velocity, 2.0, velocity]), np.eye(4), 0.5, name)


@pytest.fixture
def join():
    return FrameJoin(TOPICS, 'truth')


def test_frame_is_complete_in_any_order_of_messages():
    sends = [
        lambda a: a.add_array('truth', 5, [entry('object')], 1.0),
        lambda a: a.add_state('truth', 5, entry('object', 3.0)),
        lambda a: a.add_array('tracks', 5, [entry('1'), entry('2')], 2.0),
        lambda a: a.add_state('tracks', 5, entry('1', 4.0)),
        lambda a: a.add_state('tracks', 5, entry('2', 5.0)),
    ]
    for order in permutations(sends):
        join = FrameJoin(TOPICS, 'truth')
        for send in order[:-1]:
            send(join)
            assert join.take() == []
        order[-1](join)
        frame, = join.take()
        assert [e.state[1] for e in frame.answer('tracks')] == [4.0, 5.0]
        assert frame.answer('truth')[0].state[1] == 3.0


def test_entry_without_id_needs_no_state(join):
    join.add_array('truth', 1, [], 0.0)
    join.add_array('tracks', 1, [entry()], 0.0)
    frame, = join.take()
    assert len(frame.answer('tracks')) == 1
    assert frame.answer('truth') == []


def test_earlier_frame_is_given_up_once_a_later_one_is_complete(join):
    join.add_array('truth', 1, [], 0.0)
    for topic in TOPICS:
        join.add_array(topic, 2, [], 0.0)
    first, second = join.take()
    assert (first.stamp, second.stamp) == (1, 2)
    assert first.answer('tracks') is None
    assert join.add_array('tracks', 1, [], 0.0) is Arrival.LATE
    assert join.add_state('tracks', 1, entry('1', 1.0)) is Arrival.LATE


def send_frames_of_late_odometry(join):
    """Send two frames with tracks, and one with none; odometry comes later."""
    for stamp, tracks in ((1, [entry('1'), entry('2')]), (2, [entry('1')]), (3, [])):
        join.add_array('truth', stamp, [], float(stamp))
        join.add_array('tracks', stamp, tracks, float(stamp))


def test_later_complete_frame_waits_for_the_odometry_of_an_earlier_one(join):
    send_frames_of_late_odometry(join)
    assert join.take() == []
    join.add_state('tracks', 1, entry('1', 4.0))
    assert join.take() == []
    join.add_state('tracks', 1, entry('2', 4.0))
    assert [frame.stamp for frame in join.take()] == [1]
    join.add_state('tracks', 2, entry('1', 5.0))
    taken = join.take()
    assert [frame.stamp for frame in taken] == [2, 3]
    assert taken[0].answer('tracks')[0].state[1] == 5.0


def test_frame_does_not_wait_for_odometry_once_a_later_one_arrived(join):
    send_frames_of_late_odometry(join)
    join.add_state('tracks', 2, entry('1', 5.0))
    assert [frame.answer('tracks') is None for frame in join.take()] == [True, False, False]


@pytest.mark.parametrize('give_up', [
    lambda join: join.take(older_than_s=2.5),
    lambda join: join.expect_no_more(['tracks'], 2.5) or join.take()])
def test_frame_waits_for_odometry_no_longer_than_for_answers(join, give_up):
    send_frames_of_late_odometry(join)
    taken = give_up(join)
    assert [(frame.stamp, frame.answer('tracks')) for frame in taken + join.take()] == [
        (1, None), (2, None), (3, [])]


def test_old_frame_is_given_up(join):
    join.add_array('truth', 1, [], 10.0)
    join.add_array('truth', 2, [], 11.0)
    assert join.take(older_than_s=10.0) == []
    assert [frame.stamp for frame in join.take(older_than_s=10.5)] == [1]


def test_second_array_of_a_frame_is_rejected_as_repeated(join):
    assert join.add_array('truth', 1, [], 0.0) is Arrival.USED
    assert join.add_array('truth', 1, [entry()], 0.0) is Arrival.REPEATED


def test_frame_does_not_wait_for_answers_that_cannot_arrive(join):
    join.add_array('truth', 1, [], 1.0)
    join.add_array('truth', 2, [], 2.0)
    join.expect_no_more(['tracks'], 1.5)
    assert [frame.stamp for frame in join.take()] == [1]
    join.add_array('tracks', 2, [], 3.0)
    assert [frame.answer('tracks') for frame in join.take()] == [[]]


def test_answers_to_unknown_frames_take_bounded_memory(join):
    for stamp in range(100_000):
        join.add_array('tracks', 10_000_000 + stamp, [], 0.0)
    assert len(join._frames) <= 1001
    join.add_array('tracks', 5, [], 0.5)
    join.add_array('truth', 5, [], 0.6)
    assert [frame.stamp for frame in join.take()] == [5]


def test_clock_set_back_loses_the_first_nine_frames(join):
    join.add_array('truth', 10_000, [], 0.0)
    join.add_array('tracks', 10_000, [], 0.0)
    assert len(join.take()) == 1
    join.add_array('truth', 10_001, [], 0.1)
    taken = []
    for stamp in range(1, 31):
        join.add_array('truth', stamp, [], 1.0 + 0.1 * stamp)
        join.add_array('tracks', stamp, [], 1.0 + 0.1 * stamp)
        taken += join.take()
    # The frame that was waiting is given up; the tenth in a row shows what has happened.
    assert [frame.stamp for frame in taken] == [10_001, *range(10, 31)]
    assert taken[0].answer('tracks') is None
    assert all(frame.answer('tracks') == [] for frame in taken[1:])


def test_one_stamp_far_ahead_loses_the_next_nine_frames(join):
    join.add_array('truth', 4_000_000_000, [], 0.0)
    assert [frame.stamp for frame in join.take(older_than_s=1.0)] == [4_000_000_000]
    scored = []
    for stamp in range(1, 21):
        join.add_array('truth', stamp, [], 2.0)
        join.add_array('tracks', stamp, [], 2.0)
        scored += [frame.stamp for frame in join.take()]
    assert scored == list(range(10, 21))


def test_frame_with_late_answers_is_given_up_only_after_the_frames_it_waits_for():
    # Frames arrive once a second; the answer about one needs the next two.
    join = FrameJoin(TOPICS, 'truth', lag=2)
    for k in range(1, 6):
        join.add_array('truth', k, [], float(k))
    assert join.take(2.5) == []  # of three that it would need only two have come by then
    assert [frame.stamp for frame in join.take(4.5)] == [1, 2]
    join.add_array('tracks', 3, [], 5.0)
    assert [frame.stamp for frame in join.take(4.5)] == [3]
    assert join.take(100.0) == []  # a camera that is silent leaves its last frames open
    join.end_frames()
    assert [frame.stamp for frame in join.take(100.0)] == [4, 5]


def test_frames_whose_detections_come_after_the_restart_of_the_tracker_are_still_tracked():
    join = FrameJoin(('truth', 'detections', 'tracks'), 'truth', lag=2)
    for k in range(1, 5):
        join.add_array('truth', k, [], float(k))
        if k > 2:
            join.add_array('detections', k - 2, [], float(k))
    join.expect_no_more(('tracks',), 3.5, 'detections')  # it had received those about frame 1
    assert [frame.stamp for frame in join.take()] == [1]
    join.add_array('tracks', 2, [], 5.0)
    frame, = join.take()
    assert (frame.stamp, frame.is_answered('tracks')) == (2, True)
