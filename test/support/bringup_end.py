# SPDX-License-Identifier: Apache-2.0
"""Bring-up's end of the line to a node in the process of the test."""

import socket

from lowsnr_common.core.line import Line
from lowsnr_common.core.process_setup import StarterLine
from rclpy.serialization import deserialize_message
from rclpy.serialization import serialize_message


class BringupEnd:
    """Says what bring-up would say to a node, and hears what it says; use it in ``with``."""

    def __init__(self, node):
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        self.line, self._said = Line(ours), []
        node.bringup.connect(StarterLine(Line(theirs)))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.line.close()

    def say(self, subject, message):
        """Send the node a message."""
        self.line.send(subject, serialize_message(message))

    def heard(self, subject, kind):
        """Return the messages about a subject that the node has sent so far."""
        while found := self.line.receive():
            self._said += found
        return [deserialize_message(data, kind) for name, data in self._said if name == subject]
