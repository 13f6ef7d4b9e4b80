# SPDX-License-Identifier: Apache-2.0
"""
The line between bring-up and a node that it started: a pair of sockets that they alone have.

Whatever decides what becomes of a run goes over it: topics and services are open to everybody
on the ROS domain.
"""

from __future__ import annotations

from collections.abc import Iterator
import socket
import struct
import threading
import time

# Lengths of the topic and of the data of a message.
_HEAD = struct.Struct('<HI')
_READ_BYTES = 2**16
# What waits for a reader that stands still; messages beyond it are dropped.
_MOST_WAITING_BYTES = 2**24
_RETRY_S = 0.01
_NOW = socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL


class Line:
    """
    One end of a line.  Messages are a topic and bytes, and arrive whole and in order.

    Parameters
    ----------
    end
        One of a pair of stream sockets; :meth:`close` closes it.

    """

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        self._received, self._waiting = bytearray(), bytearray()
        self._sending = threading.Lock()

    def fileno(self) -> int:
        """Return the file descriptor, for selectors."""
        return self._end.fileno()

    def close(self) -> None:
        """Leave the line: the other end learns that."""
        self._end.close()

    def send(self, topic: str, data: bytes) -> None:
        """Send a message without waiting for the reader; what does not fit waits."""
        with self._sending:
            if len(self._waiting) < _MOST_WAITING_BYTES:
                name = topic.encode()
                self._waiting += _HEAD.pack(len(name), len(data)) + name + data
            self._send_waiting()

    def flush(self, within_s: float) -> None:
        """Send what waits, for at most so long [s]."""
        until = time.monotonic() + within_s
        while self._waiting and time.monotonic() < until:
            with self._sending:
                self._send_waiting()
            time.sleep(_RETRY_S * bool(self._waiting))

    def _send_waiting(self) -> None:
        try:
            while self._waiting:
                del self._waiting[:self._end.send(self._waiting, _NOW)]
        except BlockingIOError:
            pass
        except OSError:  # the other end is gone
            self._waiting.clear()

    def receive(self) -> list[tuple[str, bytes]] | None:
        """
        Wait for bytes; return the topics and data of the messages that they complete.

        Returns
        -------
        list or None
            Perhaps empty; None once the other end is gone and everything has been received.

        """
        try:
            data = self._end.recv(_READ_BYTES)
        except OSError:  # the other end is gone, and had not read everything
            return None
        self._received += data
        return list(self._messages()) if data else None

    def _messages(self) -> Iterator[tuple[str, bytes]]:
        while len(self._received) >= _HEAD.size:
            topic, data = _HEAD.unpack_from(self._received)
            middle, end = _HEAD.size + topic, _HEAD.size + topic + data
            if len(self._received) < end:
                return
            yield self._received[_HEAD.size:middle].decode(), bytes(self._received[middle:end])
            del self._received[:end]
