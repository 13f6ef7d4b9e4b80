"""Frames are put together whatever the order of their messages, and given up in time."""

from itertools import permutations

from lowsnr_common.core.records import Estimate
from lowsnr_eval.scoring.frame_join import Assembly
import numpy as np
import pytest

TOPICS = ('truth', 'tracks')


def entry(name='', velocity=np.nan):
    """Return an entry of an array, or, with a velocity, a state."""
    return Estimate(np.array([1.0, velocity, 2.0, velocity]), np.eye(4), 0.5, name)


@pytest.fixture
def assembly():
    return Assembly(TOPICS, 'truth')


def test_frame_is_whole_in_any_order_of_messages():
    sends = [
        lambda a: a.add_array('truth', 5, [entry('object')], 1.0),
        lambda a: a.add_state('truth', 5, entry('object', 3.0)),
        lambda a: a.add_array('tracks', 5, [entry('1'), entry('2')], 2.0),
        lambda a: a.add_state('tracks', 5, entry('1', 4.0)),
        lambda a: a.add_state('tracks', 5, entry('2', 5.0)),
    ]
    for order in permutations(sends):
        assembly = Assembly(TOPICS, 'truth')
        for send in order[:-1]:
            send(assembly)
            assert assembly.take() == []
        order[-1](assembly)
        frame, = assembly.take()
        assert [e.state[1] for e in frame.answer('tracks')] == [4.0, 5.0]
        assert frame.answer('truth')[0].state[1] == 3.0


def test_entry_without_id_needs_no_state(assembly):
    assembly.add_array('truth', 1, [], 0.0)
    assembly.add_array('tracks', 1, [entry()], 0.0)
    frame, = assembly.take()
    assert len(frame.answer('tracks')) == 1
    assert frame.answer('truth') == []


def test_earlier_frame_is_given_up_once_a_later_one_is_whole(assembly):
    assembly.add_array('truth', 1, [], 0.0)
    for topic in TOPICS:
        assembly.add_array(topic, 2, [], 0.0)
    first, second = assembly.take()
    assert (first.stamp, second.stamp) == (1, 2)
    assert first.answer('tracks') is None
    assert not assembly.add_array('tracks', 1, [], 0.0)
    assert not assembly.add_state('tracks', 1, entry('1', 1.0))


def send_frames_of_late_odometry(assembly):
    """Send two frames with tracks, and one with none; odometry comes later."""
    for stamp, tracks in ((1, [entry('1'), entry('2')]), (2, [entry('1')]), (3, [])):
        assembly.add_array('truth', stamp, [], float(stamp))
        assembly.add_array('tracks', stamp, tracks, float(stamp))


def test_later_whole_frame_does_not_outrun_odometry(assembly):
    send_frames_of_late_odometry(assembly)
    assert assembly.take() == []
    assembly.add_state('tracks', 1, entry('1', 4.0))
    assert assembly.take() == []
    assembly.add_state('tracks', 1, entry('2', 4.0))
    assert [frame.stamp for frame in assembly.take()] == [1]
    assembly.add_state('tracks', 2, entry('1', 5.0))
    taken = assembly.take()
    assert [frame.stamp for frame in taken] == [2, 3]
    assert taken[0].answer('tracks')[0].state[1] == 5.0


def test_odometry_is_not_waited_for_once_a_later_one_came(assembly):
    send_frames_of_late_odometry(assembly)
    assembly.add_state('tracks', 2, entry('1', 5.0))
    assert [frame.answer('tracks') is None for frame in assembly.take()] == [True, False, False]


@pytest.mark.parametrize('give_up', [
    lambda assembly: assembly.take(older_than_s=2.5),
    lambda assembly: assembly.expect_no_more(['tracks'], 2.5) or assembly.take()])
def test_odometry_is_waited_for_no_longer_than_answers_are(assembly, give_up):
    send_frames_of_late_odometry(assembly)
    taken = give_up(assembly)
    assert [(frame.stamp, frame.answer('tracks')) for frame in taken + assembly.take()] == [
        (1, None), (2, None), (3, [])]


def test_old_frame_is_given_up(assembly):
    assembly.add_array('truth', 1, [], 10.0)
    assembly.add_array('truth', 2, [], 11.0)
    assert assembly.take(older_than_s=10.0) == []
    assert [frame.stamp for frame in assembly.take(older_than_s=10.5)] == [1]


def test_second_array_of_a_frame_is_refused(assembly):
    assert assembly.add_array('truth', 1, [], 0.0)
    assert not assembly.add_array('truth', 1, [entry()], 0.0)


def test_answers_that_cannot_come_are_not_waited_for(assembly):
    assembly.add_array('truth', 1, [], 1.0)
    assembly.add_array('truth', 2, [], 2.0)
    assembly.expect_no_more(['tracks'], 1.5)
    assert [frame.stamp for frame in assembly.take()] == [1]
    assembly.add_array('tracks', 2, [], 3.0)
    assert [frame.answer('tracks') for frame in assembly.take()] == [[]]


def test_answers_to_frames_that_nobody_published_are_forgotten(assembly):
    for stamp in range(100_000):
        assembly.add_array('tracks', 10_000_000 + stamp, [], 0.0)
    assert len(assembly._frames) <= 1001
    assembly.add_array('tracks', 5, [], 0.5)
    assembly.add_array('truth', 5, [], 0.6)
    assert [frame.stamp for frame in assembly.take()] == [5]


def test_a_clock_set_back_loses_the_first_frames_and_no_more(assembly):
    assembly.add_array('truth', 10_000, [], 0.0)
    assembly.add_array('tracks', 10_000, [], 0.0)
    assert len(assembly.take()) == 1
    assembly.add_array('truth', 10_001, [], 0.1)
    taken = []
    for stamp in range(1, 31):
        assembly.add_array('truth', stamp, [], 1.0 + stamp)
        assembly.add_array('tracks', stamp, [], 1.0 + stamp)
        taken += assembly.take()
    # The frame that was waiting is given up; the tenth in a row shows what has happened.
    assert [frame.stamp for frame in taken] == [10_001, *range(10, 31)]
    assert taken[0].answer('tracks') is None
    assert all(frame.answer('tracks') == [] for frame in taken[1:])


def test_one_stamp_far_ahead_does_not_silence_the_rest(assembly):
    assembly.add_array('truth', 4_000_000_000, [], 0.0)
    assert [frame.stamp for frame in assembly.take(older_than_s=1.0)] == [4_000_000_000]
    scored = []
    for stamp in range(1, 21):
        assembly.add_array('truth', stamp, [], 2.0)
        assembly.add_array('tracks', stamp, [], 2.0)
        scored += [frame.stamp for frame in assembly.take()]
    assert scored == list(range(10, 21))
