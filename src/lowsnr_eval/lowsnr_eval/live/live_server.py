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
        self._history = _History()
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
            self._history.append(self._newest.popleft())
        for each in self._browsers:
            each.wake()


class _History:
    """The texts that browsers were sent, by their numbers from 0 on; the last of them are kept."""

    def __init__(self) -> None:
        self._texts: deque[str] = deque(maxlen=_MOST_FRAMES)
        self.end = 0

    @property
    def start(self) -> int:
        """Return the number of the oldest text that is kept."""
        return self.end - len(self._texts)

    def append(self, text: str) -> None:
        """Add a text; drop the oldest ones beyond the bounds."""
        self._texts.append(text)
        self.end += 1
        while len(self._texts) > 1 and sum(map(len, self._texts)) > _MOST_LETTERS:
            self._texts.popleft()

    def __getitem__(self, number: int) -> str:
        return self._texts[number - self.start]


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

    def initialize(self, all_: set[_Frames], first: str, history: _History) -> None:
        self._all, self._first, self._history = all_, first, history
        self._next = 0  # number of the text that is sent next
        self._news = asyncio.Event()
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

    def wake(self) -> None:
        """Send what is new when the browser takes it."""
        self._news.set()

    async def _send(self) -> None:
        with suppress(WebSocketClosedError):
            await self.write_message(self._first)
            await self._catch_up()
            while True:
                await self._news.wait()
                self._news.clear()
                while self._next < self._history.end:
                    await self._send_next(self._history.end - KEPT)

    async def _catch_up(self) -> None:
        """Send what there was before and what comes meanwhile, while that becomes less."""
        behind = self._history.end - self._history.start
        before = behind + 1
        while behind < before:
            before, end = behind, self._history.end
            while self._next < end:
                await self._send_next(0)
            behind = self._history.end - self._next

    async def _send_next(self, least: int) -> None:
        """Send the next text that is kept, of a number that is not below the least."""
        number = max(self._next, self._history.start, least)
        self._next = number + 1
        await self.write_message(self._history[number])
