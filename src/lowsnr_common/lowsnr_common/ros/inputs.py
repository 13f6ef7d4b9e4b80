"""An input of a node: what comes on one topic, timed, screened and looked after."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
import time
from typing import Any

from lowsnr_common.core.records import Malformed
from lowsnr_common.ros.connections import input_faults
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import qos_policy_name_from_kind
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy

CAMERA_TOPIC = 'image_raw'


def take_waiting(subscription: Any) -> Iterator[Any]:
    """Take the messages that wait for a subscription, one by one."""
    while True:
        with subscription.handle:
            found = subscription.handle.take_message(subscription.msg_type, False)
        if found is None:
            return
        yield found[0]


def drain(subscription: Any) -> None:
    """Hand the messages that wait for a subscription to its callback; a spin takes one."""
    for message in take_waiting(subscription):
        subscription.callback(message)


class Input:
    """
    A subscription of a managed node.

    Parameters
    ----------
    node
        The :class:`lowsnr_common.ros.managed_node.ManagedNode` that listens.
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
        self.awaited = needed and not self._of_camera
        self._heard_s = 0.0
        self._incompatible = ''
        self.subscription = self._subscribe()

    def begin(self) -> None:
        """
        Take silence from now on, and of a camera only what it sends from now on.

        A recorder is ready before the others, but what waits here may have come before that.
        """
        if self._of_camera and not self._node.settings.lives:
            for _ in take_waiting(self.subscription):
                pass
        self._heard_s = time.perf_counter()

    def silence(self) -> str:
        """Say whether nothing comes that should; nothing where all is well."""
        if self.needed and not self.subscription.get_publisher_count():
            return f'{self.subscription.topic_name}: nobody publishes it'
        since_s = time.perf_counter() - self._heard_s
        if self._steady and since_s > self._node.settings.silence_s:
            return f'{self.subscription.topic_name}: silent for {since_s:.0f} s'
        return ''

    def faults(self) -> list[str]:
        """Say which publishers are not heard and why, and whether there are two."""
        found = input_faults(self._node, self.subscription)
        if self._incompatible and not found:
            found = [f'{self.subscription.topic_name}: a publisher with incompatible '
                     f'{self._incompatible} came and went']
        self._incompatible = ''
        # Which reliability is available was settled when the subscription was made.
        if found and self._qos.reliability is ReliabilityPolicy.BEST_AVAILABLE and (
                not self.subscription.get_publisher_count()):
            self._node.destroy_subscription(self.subscription)
            self.subscription = self._subscribe()
        return found

    def _subscribe(self) -> Any:
        return self._node.create_subscription(
            self._kind, self._topic, self._take, self._qos,
            event_callbacks=SubscriptionEventCallbacks(
                message_lost=self._on_lost, incompatible_qos=self._on_incompatible,
                use_default_callbacks=False))

    def _take(self, message: Any) -> None:
        if self._first is not None:
            drain(self._first.subscription)
        self._heard_s = time.perf_counter()
        try:
            self._callback(message)
        except ValueError as error:
            reason = error.reason if isinstance(error, Malformed) else 'cannot be used'
            self._node.refuse(f'{self._topic}: {error}', f'{self._topic} {reason}')
        self._node.health.spent(self._topic, time.perf_counter() - self._heard_s)

    def _on_lost(self, event: Any) -> None:
        self._node.counts['lost'] += event.total_count_change
        self._node.warn(f'{self._topic}: {event.total_count_change} messages lost on the way')

    def _on_incompatible(self, event: Any) -> None:
        self._incompatible = qos_policy_name_from_kind(event.last_policy_kind).lower()
