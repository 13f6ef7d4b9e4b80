# SPDX-License-Identifier: Apache-2.0
"""
The server of a live page: it serves the page, and sends frames to the browsers that show it.

It has a thread of its own and listens on the loopback address alone.  A slow browser delays
nobody: of the frames that wait for it the server keeps the newest few and drops the others.
A page that is loaded again, or later, is first sent what others were, as far as that is kept.
A page first hears which server it has, and loads again where that is another one than before.
"""

from __future__ import annotations

import asyncio
from collections import deque
from contextlib import suppress
import json
from threading import Thread
from urllib.parse import urlsplit
from uuid import uuid4

from lowsnr_bringup.plan.loopback import listen_on
from lowsnr_bringup.plan.loopback import LOOPBACK
from tornado.httpserver import HTTPServer
from tornado.web import Application
from tornado.web import HTTPError
from tornado.web import RequestHandler
from tornado.websocket import WebSocketClosedError
from tornado.websocket import WebSocketHandler

# What is kept for each browser while it is slow, and how many browsers there may be.
KEPT, _MOST_BROWSERS = 4, 16
_OWN_NAMES = {LOOPBACK, 'localhost', '::1'}
_MOST_BYTES = 1024  # of a message from a browser, which has nothing to say
_PING_S = 20.0
# What is kept of what browsers were sent: frames, and letters.
_MOST_FRAMES, _MOST_LETTERS = 1000, 2**25
_ENDS_WITHIN_S = 2.0


class LiveServer:
    """
    Server of one page; :meth:`close` it at the end.

    Parameters
    ----------
    page
        The page, HTML.
    port
        As for :func:`listen_on`, which says what this raises.

    """

    def __init__(self, page: str, port: int = 0) -> None:
        self._socket = listen_on(port)
        self._socket.setblocking(False)
        self.address = f'http://{LOOPBACK}:{self._socket.getsockname()[1]}/'
        self._page = page
        self._browsers: set[_Frames] = set()
        self._newest: deque[str] = deque(maxlen=KEPT)
        self._history: deque[str] = deque(maxlen=_MOST_FRAMES)
        self._loop = asyncio.new_event_loop()
        self._stop = asyncio.Event()
        self._thread = Thread(target=self._run, name='live page', daemon=True)
        self._thread.start()

    @property
    def watched(self) -> bool:
        """Whether any browser shows the page; frames for none need not be made."""
        return bool(self._browsers)

    def publish(self, text: str) -> None:
        """Send a text to all browsers; this returns at once, however slow they are."""
        self._newest.append(text)
        self._loop.call_soon_threadsafe(self._share)

    def close(self) -> None:
        """Leave the port and all browsers."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._stop.set)
            self._thread.join(_ENDS_WITHIN_S)

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._serve())

    async def _serve(self) -> None:
        frames = {'all_': self._browsers, 'first': json.dumps({'server': uuid4().hex}),
                  'history': self._history}
        application = Application(
            [('/', _Page, {'page': self._page}), ('/frames', _Frames, frames)],
            websocket_ping_interval=_PING_S, websocket_max_message_size=_MOST_BYTES,
            log_function=lambda handler: None)
        server = HTTPServer(application)
        server.add_socket(self._socket)
        await self._stop.wait()
        server.stop()
        for each in list(self._browsers):
            each.close()
        await server.close_all_connections()

    def _share(self) -> None:
        while self._newest:
            text = self._newest.popleft()
            self._history.append(text)
            while sum(map(len, self._history)) > _MOST_LETTERS:
                self._history.popleft()
            for each in self._browsers:
                each.offer(text)


class _OwnHandler(RequestHandler):
    """
    Rejects requests that another site makes in the user's browser.

    Such a request names that site as its host, if its name was made to resolve to the loopback
    address, or else as its origin.
    """

    def prepare(self) -> None:
        """Raise HTTPError for a host that is not this one, and for an origin that is none."""
        try:
            host = urlsplit(f'//{self.request.host}').hostname
            urlsplit(self.request.headers.get('Origin', ''))  # Tornado parses it as it is
        except ValueError:
            raise HTTPError(403) from None
        if host not in _OWN_NAMES:
            raise HTTPError(403)


class _Page(_OwnHandler):
    """The page itself."""

    def initialize(self, page: str) -> None:
        self._page = page

    def get(self) -> None:
        for name, value in {
                'Content-Security-Policy': "frame-ancestors 'none'", 'Cache-Control': 'no-store',
                'X-Content-Type-Options': 'nosniff', 'Referrer-Policy': 'no-referrer'}.items():
            self.set_header(name, value)
        self.finish(self._page)


class _Frames(_OwnHandler, WebSocketHandler):
    """The frames that one browser is sent."""

    def initialize(self, all_: set[_Frames], first: str, history: deque[str]) -> None:
        self._all, self._before = all_, (first, *history)
        self._waiting: deque[str] = deque(maxlen=KEPT)
        self._offered = asyncio.Event()
        self._sender: asyncio.Task[None] | None = None

    def prepare(self) -> None:
        super().prepare()
        if len(self._all) >= _MOST_BROWSERS:
            raise HTTPError(503)

    def check_origin(self, origin: str) -> bool:
        return urlsplit(origin).netloc.lower() == self.request.host.lower()

    def open(self, *args: str, **kwargs: str) -> None:  # noqa: A003 (Tornado calls it)
        self._all.add(self)
        self._sender = asyncio.ensure_future(self._send())

    def on_message(self, message: str | bytes) -> None:
        """Ignore what a browser says."""

    def on_close(self) -> None:
        self._all.discard(self)
        if self._sender:
            self._sender.cancel()

    def offer(self, text: str) -> None:
        """Send a text when the browser takes it, unless newer ones displace it before."""
        self._waiting.append(text)
        self._offered.set()

    async def _send(self) -> None:
        with suppress(WebSocketClosedError):
            for text in self._before:
                await self.write_message(text)
            while True:
                await self._offered.wait()
                self._offered.clear()
                while self._waiting:
                    await self.write_message(self._waiting.popleft())
