# SPDX-License-Identifier: Apache-2.0
"""Topics between nodes of one process, whose messages are handed over as the objects they are."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from functools import partial
import time
from typing import Any

from lowsnr_common.ros.diagnostics import Fault
from lowsnr_common.ros.inputs import Input


class LocalTopics:
    """
    The topics that nodes of this process publish for each other.

    A message is neither copied nor serialized: its readers must not change it.

    Parameters
    ----------
    call_soon
        Calls a function once the present callback has returned.

    """

    def __init__(self, call_soon: Callable[[Callable[[], None]], None]) -> None:
        self._call_soon = call_soon
        self._offered: set[str] = set()
        self._readers: dict[str, list[Callable[[Any], None]]] = defaultdict(list)

    def offer(self, topic: str) -> None:
        """Have the messages of a topic, by its full name, handed over from now on."""
        self._offered.add(topic)

    def offers(self, topic: str) -> bool:
        """Return whether a topic, by its full name, is handed over."""
        return topic in self._offered

    def join(self, topic: str, take: Callable[[Any], None]) -> None:
        """Call a function with each message of a topic."""
        self._readers[topic].append(take)

    def leave(self, topic: str, take: Callable[[Any], None]) -> None:
        """Call a function no more."""
        self._readers[topic].remove(take)

    def readers(self, topic: str) -> int:
        """Return how many read a topic here."""
        return len(self._readers[topic]) if topic in self._offered else 0

    def hand_over(self, topic: str, message: Any) -> None:
        """Hand a message to all that read its topic here, in the order in which they joined."""
        for take in self._readers[topic] if topic in self._offered else ():
            self._call_soon(partial(take, message))


class LocalInput(Input):
    """An input from a node of the same process: no publisher can lack, and none can be unfit."""

    def _subscribe(self) -> None:
        self._full_name = self._node.resolve_topic_name(self._topic)
        self._node.local.join(self._full_name, self._take)
        self.awaited = False

    def close(self) -> None:
        """Take no more messages."""
        self._node.local.leave(self._full_name, self._take)

    def drain(self) -> None:
        """Do nothing: nothing waits, because each message is taken in its turn."""

    def begin(self) -> None:
        """Start to measure silence."""
        self._received_s = time.perf_counter()

    def silence(self) -> list[Fault]:
        """Return whether messages that should come do not."""
        return self._silent(self._full_name)

    def faults(self) -> list[Fault]:
        """Return nothing: no other node publishes to it."""
        return []
