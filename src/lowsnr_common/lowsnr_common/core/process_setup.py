# SPDX-License-Identifier: Apache-2.0
"""The process of a node: how it ends with its starter, its memory, and its exit statuses."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from collections.abc import Iterator
import ctypes
import os
import signal
import socket
import sys
import threading

from lowsnr_common.core.line import Line

LIFELINE = 'LOWSNR_LIFELINE'
# Exit statuses: of a node that cannot become active, of one with a setting out of its bounds, of
# one that was shut down through its lifecycle, and after SIGINT and SIGTERM.
FAILED, USAGE_ERROR, SHUT_DOWN = 1, 2, 3
INTERRUPTED, TERMINATED = 128 + signal.SIGINT, 128 + signal.SIGTERM
# Parameters of mallopt(3), as malloc.h numbers them.
_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8
_KEPT_BYTES = 2**30


class StarterLine:
    """
    A node's end of the line to the bring-up that started it.

    Without a starter it is not ``connected`` and does nothing.

    Parameters
    ----------
    line
        The line, None without a starter.
    on_end
        Called, in a thread of its own, when the starter is gone.

    """

    def __init__(self, line: Line | None, on_end: Callable[[], None] = lambda: None) -> None:
        self._line, self._on_end = line, on_end
        self._received: deque[tuple[str, bytes]] = deque()
        self._notify: Callable[[], None] = lambda: None
        if line is not None:
            threading.Thread(target=self._listen, args=(line,), daemon=True).start()

    @property
    def connected(self) -> bool:
        """Whether this process has a starter."""
        return self._line is not None

    def send(self, topic: str, data: bytes) -> None:
        """Send the starter a message."""
        if self._line is not None:
            self._line.send(topic, data)

    def flush(self, within_s: float) -> None:
        """Send what waits for the starter, for at most so long [s]."""
        if self._line is not None:
            self._line.flush(within_s)

    def take(self) -> Iterator[tuple[str, bytes]]:
        """Yield the messages that have been received."""
        while self._received:
            yield self._received.popleft()

    def call_when_received(self, notify: Callable[[], None]) -> None:
        """Have a function called, in a thread of its own, after messages were received."""
        self._notify = notify
        notify()

    def _listen(self, line: Line) -> None:
        while (found := line.receive()) is not None:
            self._received.extend(found)
            self._notify()
        line.close()
        self._on_end()


def end_with_starter(count: int = 1) -> list[StarterLine]:
    """
    Have this process end by SIGTERM when the process that started it is gone.

    The starter passes one end of a pair of sockets for each node of the process and names their
    file descriptors in the environment variable ``LOWSNR_LIFELINE``, commas between.  The kernel
    closes the other ends with the starter.

    Returns
    -------
    list of StarterLine
        The lines to the starter, one a node; without the variable they lead nowhere.

    """
    numbers = os.environ.pop(LIFELINE, None)
    if numbers is None:
        return [StarterLine(None) for _ in range(count)]
    return [
        StarterLine(Line(socket.socket(fileno=int(number))),
                    lambda: os.kill(os.getpid(), signal.SIGTERM))
        for number in numbers.split(',')]


def keep_freed_memory() -> None:
    """
    Have the C library keep up to 1 GiB of freed memory for later allocations of any thread.

    By default it returns large arrays to the kernel, which clears every page of the next ones:
    for a frame of 2048 x 2048 cells that takes as long as the detector.  The threads of the
    middleware would have a heap each, whose size no frame of 4096 x 4096 pixels fits; all share
    one instead.  Call it before the process starts a thread.  Without the GNU C library nothing
    changes.
    """
    if sys.platform != 'linux':
        return
    mallopt = getattr(ctypes.CDLL(None), 'mallopt', None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _KEPT_BYTES)
        mallopt(_TRIM_THRESHOLD, _KEPT_BYTES)
        mallopt(_ARENA_MAX, 1)
