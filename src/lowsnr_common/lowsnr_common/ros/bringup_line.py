# SPDX-License-Identifier: Apache-2.0
"""What a node and the bring-up that started it tell each other: ROS messages over their line."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

from lowsnr_common.core.process_setup import StarterLine
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.serialization import serialize_message

# Subjects besides those of :mod:`lowsnr_common.ros.run_records`.  The first three are copies of
# what a node publishes; CHANGE_STATE is a Transition that bring-up asks for, and the
# TransitionEvent that a node answers.
DATA_TIME, STATUS, PARAMETERS = '/clock', '/diagnostics', '/parameter_events'
CHANGE_STATE = 'change_state'
# The stamp, a Clock, of the last frame of the run: the source has ended.
LAST_FRAME = 'last_frame'
# The address, a String, of a viewer's live page.
LIVE_PAGE = 'live_page'
_FLUSH_WITHIN_S = 2.0


class BringupLine:
    """
    A node's line to bring-up; a node that was started otherwise has none, and tells nobody.

    Parameters
    ----------
    node
        The node, whose executor calls what :meth:`hear` registers.

    """

    def __init__(self, node: Node) -> None:
        self._line = StarterLine(None)
        self._handlers: dict[str, tuple[type, Callable[[Any], None]]] = {}
        self._received = node.create_guard_condition(self._take)

    @property
    def connected(self) -> bool:
        """Whether bring-up started the node."""
        return self._line.connected

    def connect(self, line: StarterLine) -> None:
        """Use this line from now on."""
        self._line = line
        line.call_when_received(self._wake)

    def tell(self, subject: str, message: Any) -> None:
        """Send bring-up a message."""
        if self.connected:
            self._line.send(subject, serialize_message(message))

    def hear(self, subject: str, kind: type, handler: Callable[[Any], None]) -> None:
        """Call a function with what bring-up says about a subject."""
        self._handlers[subject] = kind, handler

    def leave(self) -> None:
        """Send what bring-up has not received yet, before the node ends."""
        self._line.flush(_FLUSH_WITHIN_S)

    def _wake(self) -> None:
        with suppress(InvalidHandle):  # the node may have been destroyed
            self._received.trigger()

    def _take(self) -> None:
        for subject, data in self._line.take():
            if subject in self._handlers:
                kind, handler = self._handlers[subject]
                handler(deserialize_message(data, kind))
