# SPDX-License-Identifier: Apache-2.0
"""The line between bring-up and a node: whole messages in order, and no wait for a reader."""

import socket

from lowsnr_common.core.line import Line
import pytest


@pytest.fixture
def ends():
    """Return both ends of a line."""
    lines = [Line(end) for end in socket.socketpair()]
    yield lines
    for line in lines:
        line.close()


def received(line, count):
    """Return the next messages."""
    found = []
    while len(found) < count:
        found += line.receive()
    return found


def test_messages_arrive_whole_and_in_order_both_ways(ends, rng):
    sent = [(f't{n}', rng.bytes(int(size))) for n, size in enumerate([0, 1, 7, 65_536, 70_000])]
    for here, there in (ends, ends[::-1]):
        for message in sent:
            here.send(*message)
        assert received(there, len(sent)) == sent


def test_writer_does_not_wait_for_a_reader_that_stands_still_and_loses_nothing(ends, rng):
    sent = [('clock', rng.bytes(1000)) for _ in range(3000)]  # more than the kernel holds
    for message in sent:
        ends[0].send(*message)
    found = received(ends[1], 1)
    while len(found) < len(sent):
        ends[0].flush(0.1)
        found += received(ends[1], 1)
    assert found == sent


def test_what_waits_is_bounded(ends):
    for _ in range(40):
        ends[0].send('big', bytes(2**20))
    count = 0
    while count < 16:
        ends[0].flush(0.001)
        count += len(ends[1].receive())
    ends[0].flush(0.1)
    ends[0].close()
    while (found := ends[1].receive()) is not None:
        count += len(found)
    assert 16 <= count <= 18


def test_end_of_the_other_side_is_known_after_its_last_message(ends):
    ends[0].send('last', b'words')
    ends[0].close()
    assert received(ends[1], 1) == [('last', b'words')]
    assert ends[1].receive() is None


def test_writer_outlives_the_other_side(ends):
    ends[1].close()
    for _ in range(3):
        ends[0].send('to', b'nobody')
    assert ends[0].receive() is None
