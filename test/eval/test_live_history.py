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


async def received(server, count):
    """Return the first texts that a new browser is sent, without the first of all."""
    connection = await websocket_connect(server.address.replace('http', 'ws') + 'frames')
    found = [await asyncio.wait_for(connection.read_message(), 60.0) for _ in range(count + 1)]
    connection.close()
    assert 'server' in json.loads(found[0])
    return found[1:]


def publish(server, text):
    """Publish a text, and wait until the server has it: of many at once it drops some."""
    server.publish(text)
    until = time.monotonic() + 60.0
    while not server._history or server._history[-1] != text:
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
