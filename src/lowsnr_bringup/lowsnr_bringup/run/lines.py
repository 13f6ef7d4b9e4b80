# SPDX-License-Identifier: Apache-2.0
"""Bring-up's ends of the lines to the nodes that it started."""

from __future__ import annotations

from collections.abc import Iterator
import selectors
import socket

from lowsnr_common.core.line import Line


class Lines:
    """The lines to all processes of a run, those of ended processes until they are read out."""

    def __init__(self) -> None:
        self._selector = selectors.DefaultSelector()

    def add(self) -> tuple[Line, socket.socket]:
        """Make a line; return this end, and the other one for the new process."""
        ours, theirs = socket.socketpair()
        line = Line(ours)
        self._selector.register(line, selectors.EVENT_READ)
        return line, theirs

    def heard(self, within_s: float) -> Iterator[tuple[Line, str, bytes]]:
        """Wait for at most so long [s]; yield line, topic and data of all that was said."""
        while ready := self._selector.select(within_s):
            within_s = 0.0
            for key, _ in ready:
                line = key.fileobj
                assert isinstance(line, Line)
                if (found := line.receive()) is None:
                    self._drop(line)
                else:
                    yield from ((line, topic, data) for topic, data in found)

    def close(self) -> None:
        """Leave all lines, which ends the processes at the other ends."""
        for key in list(self._selector.get_map().values()):
            assert isinstance(key.fileobj, Line)
            self._drop(key.fileobj)
        self._selector.close()

    def _drop(self, line: Line) -> None:
        self._selector.unregister(line)
        line.close()
