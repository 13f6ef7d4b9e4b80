# SPDX-License-Identifier: Apache-2.0
"""A topic that the recorder receives: its subscription, its counts, its place in the bag."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence
from importlib import import_module
from typing import Any

from lowsnr_bringup.bags.recording import Tally
from lowsnr_bringup.bags.storage import Qos
from lowsnr_bringup.bags.type_definitions import type_definition
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo

Info = dict[str, int]


def message_class(msgtype: str, publishers: Sequence[TopicEndpointInfo]) -> type:
    """
    Return the Python class of a message type.

    Raises
    ------
    ValueError
        If no installed package defines the type, or a publisher has another definition of it.
    ImportError, AttributeError
        If the class is missing.

    """
    # Checked first: a publisher chooses the name, and only message types may be imported.
    digest = type_definition(msgtype).digest
    package, _, name = msgtype.split('/')
    found: type = getattr(import_module(f'{package}.msg'), name)
    if {str(item.topic_type_hash) for item in publishers} != {digest}:
        raise ValueError(f'{msgtype}: publishers have another definition of this type')
    return found


class RecordedTopic:
    """
    A subscription that hands on messages as bytes and counts those that are lost.

    Parameters
    ----------
    node
        The recorder.
    name, kind, depth
        Name of the topic, class of its messages, and quality of service to request.
    on_message
        Receives the bytes of a message and its times and numbers.
    since_start
        Whether the recorder receives the topic from its first message on.

    """

    def __init__(
        self, node: Node, name: str, kind: type, depth: QoSProfile,
        on_message: Callable[[bytes, Info], None], since_start: bool,
    ) -> None:
        self.name = name
        self.tally = Tally(last=0 if since_start else None)
        self._node, self._kind, self._on_message = node, kind, on_message
        self._subscription = node.create_subscription(
            kind, name, self._receive, depth, raw=True,
            event_callbacks=SubscriptionEventCallbacks(
                message_lost=self._on_lost, use_default_callbacks=False))

    def is_matched(self) -> bool:
        """Whether the subscription has found every publisher of the topic."""
        publishers = self._node.count_publishers(self.name)
        return bool(self._subscription.get_publisher_count() >= publishers)

    def count_publishers(self) -> None:
        """Count by the middleware from now on if the topic has several publishers."""
        self.tally.shared |= self._subscription.get_publisher_count() > 1

    def take(self) -> int | None:
        """Take a waiting message; return when it was received [ns], None if none waits."""
        with self._subscription.handle:
            found = self._subscription.handle.take_message(self._kind, True)
        if found is None:
            return None
        self._receive(*found)
        return int(found[1]['received_timestamp'])

    def _receive(self, data: bytes, info: Info) -> None:
        self.tally.add(info['publication_sequence_number'])
        self._on_message(data, info)

    def _on_lost(self, event: Any) -> None:
        self.tally.reported = event.total_count


def offered_qos(profile: QoSProfile) -> Qos:
    """Return what a publisher offers, as version 9 of rosbag2 writes it."""
    return {
        'history': profile.history.name.lower(),
        'depth': profile.depth,
        'reliability': profile.reliability.name.lower(),
        'durability': profile.durability.name.lower(),
        'deadline': _time(profile.deadline),
        'lifespan': _time(profile.lifespan),
        'liveliness': profile.liveliness.name.lower(),
        'liveliness_lease_duration': _time(profile.liveliness_lease_duration),
        'avoid_ros_namespace_conventions': profile.avoid_ros_namespace_conventions}


def _time(duration: Duration) -> dict[str, int]:
    seconds, nanoseconds = divmod(duration.nanoseconds, 1_000_000_000)
    return {'sec': seconds, 'nsec': nanoseconds}
