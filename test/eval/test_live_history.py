# SPDX-License-Identifier: Apache-2.0
"""A browser that comes later, or again, is sent what others were before, within bounds."""

import asyncio
from contextlib import closing
import json
import time

from lowsnr_eval.live import live_server
from lowsnr_eval.live.live_server import LiveServer
import pytest
from tornado.websocket import websocket_connect


async def ended(connection):
    """Close a connection, and wait until it is."""
    connection.close()
    while await asyncio.wait_for(connection.read_message(), 60.0) is not None:
        pass


async def received(server, count):
    """Return the first texts that a new browser is sent, without the first of all."""
    connection = await websocket_connect(server.address.replace('http', 'ws') + 'frames')
    found = [await asyncio.wait_for(connection.read_message(), 60.0) for _ in range(count + 1)]
    await ended(connection)
    assert 'server' in json.loads(found[0])
    return found[1:]


def publish(server, text):
    """Publish a text, and wait until the server has it: of many at once it drops some."""
    count, until = server._history.end, time.monotonic() + 60.0
    server.publish(text)
    while server._history.end == count:
        assert time.monotonic() < until, 'the server does not take it'
        time.sleep(0.001)


@pytest.mark.parametrize(('texts', 'most_letters', 'kept'), [
    (['a', 'bb', 'ccc'], 1000, ['a', 'bb', 'ccc']),
    (['a' * 600, 'b' * 500, 'c' * 400], 1000, ['b' * 500, 'c' * 400])])
def test_later_browser_is_sent_what_is_kept_and_then_what_is_new(
        monkeypatch, texts, most_letters, kept):
    monkeypatch.setattr(live_server, '_MOST_LETTERS', most_letters)
    with closing(LiveServer('page')) as server:
        for text in texts:
            publish(server, text)
        for _ in range(2):  # also when it is loaded again
            assert asyncio.run(received(server, len(kept))) == kept
        server.publish('new')
        assert asyncio.run(received(server, len(kept) + 1))[-1] == 'new'


def test_frames_that_are_kept_are_bounded():
    with closing(LiveServer('page')) as server:
        for number in range(live_server._MOST_FRAMES + 7):
            publish(server, str(number))
        found = asyncio.run(received(server, live_server._MOST_FRAMES))
    assert len(found) == live_server._MOST_FRAMES
    assert found == [str(7 + n) for n in range(len(found))]


def test_browser_misses_nothing_that_comes_while_it_is_sent_what_was_before():
    """It reads when 20 more have come; 24 MB do not fit into the buffers of a connection."""
    async def numbers(server):
        address = server.address.replace('http', 'ws') + 'frames'
        connection = await websocket_connect(address)
        await asyncio.wait_for(connection.read_message(), 60.0)
        for number in range(24, 44):
            await asyncio.to_thread(publish, server, str(number))
        found = [await asyncio.wait_for(connection.read_message(), 60.0) for _ in range(44)]
        await ended(connection)
        return [int(text.partition(' ')[0]) for text in found]

    with closing(LiveServer('page')) as server:
        for number in range(24):
            publish(server, f'{number} {10**6 * "x"}')
        assert asyncio.run(numbers(server)) == list(range(44))
