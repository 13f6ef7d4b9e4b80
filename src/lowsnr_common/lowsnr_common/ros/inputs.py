# SPDX-License-Identifier: Apache-2.0
"""An input of a node: a subscription that times, checks and counts what it receives."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Collection
from collections.abc import Iterator
import time
from typing import Any

from lowsnr_common.core.records import Malformed
from lowsnr_common.images.receive_buffer import remedy
from lowsnr_common.ros.connections import input_faults
from lowsnr_common.ros.connections import OTHER_QOS
from lowsnr_common.ros.diagnostics import Fault
from lowsnr_common.ros.images import unpacked
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import qos_policy_name_from_kind
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import CompressedImage
from sensor_msgs.msg import Image

CAMERA_TOPIC = 'image_raw'
# Reasons of faults.
NO_PUBLISHER, SILENT, LOST, UNUSABLE = 'no publisher', 'silent', 'lost', 'cannot be used'


def take_waiting(subscription: Any) -> Iterator[tuple[Any, dict[str, Any]]]:
    """
    Yield the messages in the queue of a subscription, each with what the middleware says of it.

    At most as many as the queue holds: where messages arrive faster than they are used, the
    queue is never empty, and those that came meanwhile are left for later.
    """
    for _ in range(subscription.qos_profile.depth):
        with subscription.handle:
            found = subscription.handle.take_message(subscription.msg_type, False)
        if found is None:
            return
        yield found


class LostMessages:
    """
    The messages of a publisher that did not arrive, by gaps in the numbers that it gives them.

    The middleware reports what a network or a publisher lost, but not what left the queue of a
    reader that is too slow.

    Parameters
    ----------
    publishers
        Returns the publishers that are there now.

    """

    def __init__(self, publishers: Callable[[], Collection[Any]]) -> None:
        self._publishers, self._known = publishers, publishers()
        self._last: int | None = None
        self._owed = 0  # reported, and not yet seen as a gap

    def arrived(self, number: int | None) -> int:
        """Return how many are newly known to be lost, with the number of a message, if any."""
        last, self._last = self._last, number
        if number is not None and last is not None and number == last + 1:
            return 0
        owed, self._owed = self._owed, 0
        if number is None:
            return 0
        known, self._known = self._known, self._publishers()
        if last is None or number <= last or len(known) != 1 or self._known != known:
            return 0  # the first one, or those of others
        gap = number - last - 1
        self._owed = max(owed - gap, 0)
        return max(gap - owed, 0)

    def reported(self, count: int) -> int:
        """Return how many are newly known to be lost, as the middleware reports so many."""
        self._owed += count
        return count


class Input:
    """
    A subscription of a managed node.

    Parameters
    ----------
    node
        The :class:`lowsnr_common.ros.managed_node.ManagedNode` that subscribes.
    kind, topic, callback, qos, needed, steady, first
        As for its ``listen``.

    """

    def __init__(
        self, node: Any, kind: type, topic: str, callback: Callable[[Any], None],
        qos: QoSProfile, needed: bool, steady: bool,
        first: Input | None,
    ) -> None:
        self._node, self._kind, self._topic, self._qos = node, kind, topic, qos
        self._callback, self._first = callback, first
        self.needed, self._steady = needed, needed and steady
        self._of_camera = node.settings.live and topic == CAMERA_TOPIC
        self._compressed = self._of_camera and node.settings.compressed
        self.awaited = needed and not self._of_camera
        self._received_s = 0.0
        self._incompatible = ''
        self.follows = qos.reliability is ReliabilityPolicy.BEST_AVAILABLE
        self._reliability = qos.reliability
        self.subscription = self._subscribe()

    def close(self) -> None:
        """End the subscription."""
        self._node.destroy_subscription(self.subscription)

    def drain(self) -> None:
        """Take the messages that wait."""
        for message, info in take_waiting(self.subscription):
            self._receive(message, info)

    def begin(self) -> None:
        """
        Start to measure silence; drop what a camera sent before.

        A recorder becomes active before the other nodes.  What is in the queue here may have
        arrived even before that, and would be answered without being recorded.
        """
        if self._of_camera and not self._node.settings.lives:
            for _ in take_waiting(self.subscription):
                pass
            self._lost = LostMessages(self._publisher_ids)
        self._received_s = time.perf_counter()

    def silence(self) -> list[Fault]:
        """Return whether messages that should come do not."""
        topic = self.subscription.topic_name
        if self.needed and not self.subscription.get_publisher_count():
            return [Fault(topic, NO_PUBLISHER, 'nobody publishes it')]
        return self._silent(topic)

    def _silent(self, topic: str) -> list[Fault]:
        since_s = time.perf_counter() - self._received_s
        if self._steady and since_s > self._node.settings.silence_s:
            return [Fault(topic, SILENT, f'no message for {since_s:.0f} s')]
        return []

    def faults(self) -> list[Fault]:
        """Return which publishers do not fit and why, and whether there are several."""
        if self.follows:
            self._follow()
        found = input_faults(self._node, self.subscription)
        if self._incompatible and not found:
            found = [Fault(
                self.subscription.topic_name, OTHER_QOS,
                f'a publisher with incompatible {self._incompatible} came and went')]
        self._incompatible = ''
        return found

    def _follow(self) -> None:
        """
        Subscribe again if the publishers offer another reliability.

        A subscription that receives is left as it is while the node works: a change costs frames.
        """
        receives = bool(self.subscription.get_publisher_count())
        if (self._wanted() is self._reliability or (receives and self._node.active)
                or (receives and not self._of_camera)):
            return
        self._node.destroy_subscription(self.subscription)
        self.subscription = self._subscribe()
        self._incompatible = ''

    def _wanted(self) -> ReliabilityPolicy:
        """Return the reliability of the publishers, as far as they are known."""
        topic = self._node.resolve_topic_name(self._topic)
        offered = {
            each.qos_profile.reliability
            for each in self._node.get_publishers_info_by_topic(topic)}
        if offered:
            return (ReliabilityPolicy.RELIABLE if offered == {ReliabilityPolicy.RELIABLE}
                    else ReliabilityPolicy.BEST_EFFORT)
        # A camera that comes later is heard whatever it offers; others are nodes of the run.
        return ReliabilityPolicy.BEST_EFFORT if self._of_camera else ReliabilityPolicy.RELIABLE

    def _subscribe(self) -> Any:
        """Subscribe; where any reliability will do, with that of the publisher."""
        if self.follows:
            self._reliability = self._wanted()
            self._qos.reliability = self._reliability
        self._lost = LostMessages(self._publisher_ids)
        return self._node.create_subscription(
            CompressedImage if self._compressed else self._kind, self._topic, self._receive,
            self._qos,
            event_callbacks=SubscriptionEventCallbacks(
                message_lost=self._on_lost, incompatible_qos=self._on_incompatible,
                use_default_callbacks=False))

    def _publisher_ids(self) -> set[tuple[int, ...]]:
        return {tuple(each.endpoint_gid) for each in self._node.get_publishers_info_by_topic(
            self._node.resolve_topic_name(self._topic))}

    def _receive(self, message: Any, info: dict[str, Any]) -> None:
        self._lose(self._lost.arrived(info['publication_sequence_number']),
                   'lost {} messages, which came faster than they are taken')
        self._take(message)

    def _take(self, message: Any) -> None:
        if self._first is not None:
            self._first.drain()
        self._received_s = time.perf_counter()
        try:
            self._callback(unpacked(message) if self._compressed else message)
        except ValueError as error:
            reason = error.reason if isinstance(error, Malformed) else UNUSABLE
            self._node.reject(self._topic, reason, str(error))
        self._node.health.spent(self._topic, time.perf_counter() - self._received_s)

    def _on_lost(self, event: Any) -> None:
        self._lose(self._lost.reported(event.total_count_change),
                   'the middleware lost {} messages'
                   + (remedy() if self._kind is Image else ''))

    def _lose(self, count: int, what: str) -> None:
        if count:
            self._node.counts['lost'] += count
            self._node.warn(Fault(self._topic, LOST, what.format(count)))

    def _on_incompatible(self, event: Any) -> None:
        self._incompatible = qos_policy_name_from_kind(event.last_policy_kind).lower()
