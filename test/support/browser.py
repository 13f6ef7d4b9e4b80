# SPDX-License-Identifier: Apache-2.0
"""A headless Chromium, driven over the pipe of its debugging protocol."""

import base64
from collections.abc import Iterator
from contextlib import contextmanager
import fcntl
import json
import os
from pathlib import Path
import select
import socket
import subprocess
import time
from typing import Any

_WITHIN_S = 120.0
_FLAGS = (
    '--headless', '--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run',
    '--disable-background-networking', '--disable-component-update', '--disable-sync',
    '--hide-scrollbars', '--window-size=1100,1400', '--remote-debugging-pipe')
_KEYS = {'ArrowLeft': 37, 'ArrowRight': 39, 'Home': 36, 'End': 35, '+': 187, '0': 48, ' ': 32}


class Browser:
    """One page of a browser; ``requests`` are the addresses that it requested."""

    def __init__(self, orders: int, answers: int) -> None:
        self._orders, self._answers = orders, answers
        self._buffer = b''
        self._number = 0
        self._session: dict[str, str] = {}
        self.requests: list[str] = []
        self.errors: list[str] = []
        target = self.call('Target.createTarget', url='about:blank')['targetId']
        attached = self.call('Target.attachToTarget', targetId=target, flatten=True)
        self._session = {'sessionId': attached['sessionId']}
        for domain in ('Network', 'Page', 'Runtime', 'Log'):
            self.call(f'{domain}.enable')

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Send a command and return its answer; record the events that come before it."""
        self._number += 1
        order = {'id': self._number, 'method': method, 'params': params, **self._session}
        os.write(self._orders, json.dumps(order).encode() + b'\0')
        while (message := self._read()).get('id') != self._number:
            self._note(message)
        assert 'error' not in message, message
        return message['result']

    def load(self, page: Path | str) -> None:
        """Load a file or an address, and wait until the page has run its scripts."""
        self.call('Page.navigate', url=page if isinstance(page, str) else page.as_uri())
        until = time.monotonic() + _WITHIN_S
        while self.value('document.readyState') != 'complete':
            assert time.monotonic() < until, 'the page does not load'

    def value(self, expression: str) -> Any:
        """Return the value of a JavaScript expression in the page."""
        answer = self.call('Runtime.evaluate', expression=expression, returnByValue=True)
        assert 'exceptionDetails' not in answer, answer
        return answer['result'].get('value')

    def click(self, selector: str) -> None:
        """Click on an element with the mouse."""
        x, y = self.value(f"""(() => {{
            const element = document.querySelector({json.dumps(selector)});
            element.scrollIntoView();
            const box = element.getBoundingClientRect();
            return [box.x + box.width / 2, box.y + box.height / 2]; }})()""")
        for kind in ('mousePressed', 'mouseReleased'):
            self.call('Input.dispatchMouseEvent', type=kind, x=x, y=y, button='left', clickCount=1)

    def press(self, key: str) -> None:
        """Press a key."""
        for kind in ('rawKeyDown', 'keyUp'):
            self.call('Input.dispatchKeyEvent', type=kind, key=key, code=key,
                      windowsVirtualKeyCode=_KEYS[key])

    def screenshot(self, path: Path) -> None:
        """Write a picture of the visible part of the page."""
        path.write_bytes(base64.b64decode(self.call('Page.captureScreenshot')['data']))

    def _read(self) -> dict[str, Any]:
        while b'\0' not in self._buffer:
            ready, _, _ = select.select([self._answers], [], [], _WITHIN_S)
            assert ready, 'the browser does not answer'
            more = os.read(self._answers, 2**20)
            assert more, 'the browser has ended'
            self._buffer += more
        text, _, self._buffer = self._buffer.partition(b'\0')
        return json.loads(text)

    def _note(self, message: dict[str, Any]) -> None:
        params = message.get('params', {})
        if message.get('method') == 'Network.requestWillBeSent':
            self.requests.append(params['request']['url'])
        elif message.get('method') == 'Runtime.exceptionThrown':
            self.errors.append(str(params['exceptionDetails'].get('exception', params)))
        elif message.get('method') == 'Log.entryAdded' and params['entry']['level'] == 'error':
            self.errors.append(params['entry']['text'])


def port_of_no_other() -> int:
    """Return a free port that is none of those from which live pages choose theirs."""
    with socket.create_server(('127.0.0.1', 0)) as probe:
        return int(probe.getsockname()[1])


@contextmanager
def browser(program: str, profile: Path) -> Iterator[Browser]:
    """Start a browser with a profile of its own; it ends with the block."""
    (reading, orders), (answers, writing) = os.pipe(), os.pipe()
    # The browser reads from file 3 and writes to file 4, so its ends must have other numbers.
    ends = [fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (reading, writing)]
    process = subprocess.Popen(
        ['bash', '-c', f'exec "$0" "$@" 3<&{ends[0]} 4>&{ends[1]}', program, *_FLAGS,
         f'--user-data-dir={profile}'],
        pass_fds=ends, stderr=subprocess.DEVNULL)
    for end in (reading, writing, *ends):
        os.close(end)
    try:
        yield Browser(orders, answers)
    finally:
        os.close(orders)  # the browser ends when its input does
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        os.close(answers)
