"""Who is on a node's topics: missing, not connected and why, or yet to acknowledge."""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping
import time
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import qos_check_compatible
from rclpy.qos import QoSCompatibility
from rclpy.qos import QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo

# Names that one line holds.
_MOST_NAMES = 5
_ACKNOWLEDGED_WITHIN_S = 10.0


def missing_peer(outputs: Mapping[Any, int], inputs: Iterable[Any]) -> str:
    """
    Say which reader or writer is not connected yet; nothing where all are.

    Both ends of a connection find each other at their own time, and a reader that has not found
    its writer loses what the writer sends.  So each node looks at both.

    Parameters
    ----------
    outputs
        Publishers, each with the number of readers that it must have.
    inputs
        Subscriptions that must have a writer.

    """
    for publisher, needed in outputs.items():
        if (found := publisher.get_subscription_count()) < needed:
            return f'{publisher.topic_name}: {found} of {needed} readers (see consumers)'
    for subscription in inputs:
        if not subscription.get_publisher_count():
            return f'{subscription.topic_name}: nobody publishes it'
    return ''


def wait_for_readers(
    publishers: Iterable[Any], within_s: float = _ACKNOWLEDGED_WITHIN_S,
) -> None:
    """Wait until every reader has every message, but not for long [s]: one may have died."""
    until = time.monotonic() + within_s
    for publisher in publishers:
        left_s = max(0.0, until - time.monotonic())
        publisher.wait_for_all_acked(Duration(seconds=left_s))


def input_faults(node: Node, subscription: Any) -> list[str]:
    """Say which publishers of a subscription's topic it cannot hear, and whether it hears two."""
    topic, heard = subscription.topic_name, subscription.get_publisher_count()
    known = node.count_publishers(topic)
    if known <= heard <= 1:
        return []
    publishers = node.get_publishers_info_by_topic(topic)
    faults = []
    # One of a name that died and was started again is known for a while beside its successor.
    if heard > 1 and len({name_of(publisher) for publisher in publishers}) > 1:
        faults.append(f'{topic}: {heard} publishers: {_names(publishers)}')
    if known > heard:
        own = _own(node, node.get_subscriptions_info_by_topic(topic))
        kind = type_name(subscription.msg_type)
        faults += [
            f'{topic}: not heard is {name_of(other)}, which publishes {why}'
            for other in publishers[:_MOST_NAMES]
            if (why := _mismatch(other, kind, other.qos_profile, own or subscription.qos_profile))]
    return faults


def output_faults(node: Node, publisher: Any) -> list[str]:
    """Say which readers of a publisher's topic it cannot reach."""
    topic = publisher.topic_name
    if node.count_subscribers(topic) <= publisher.get_subscription_count():
        return []
    own = _own(node, node.get_publishers_info_by_topic(topic)) or publisher.qos_profile
    kind = type_name(publisher.msg_type)
    return [
        f'{topic}: not reached is {name_of(other)}, which reads {why}'
        for other in node.get_subscriptions_info_by_topic(topic)[:_MOST_NAMES]
        if (why := _mismatch(other, kind, own, other.qos_profile))]


def name_of(endpoint: TopicEndpointInfo) -> str:
    """Return the full name of the node of an endpoint."""
    return f'{endpoint.node_namespace}/{endpoint.node_name}'.replace('//', '/')


def type_name(kind: type) -> str:
    """Return a message class's type as the middleware names it."""
    return f'{kind.__module__.partition(".")[0]}/msg/{kind.__name__}'


def _names(endpoints: Iterable[TopicEndpointInfo]) -> str:
    names = sorted(name_of(endpoint) for endpoint in endpoints)
    more = ', ...' if len(names) > _MOST_NAMES else ''
    return ', '.join(names[:_MOST_NAMES]) + more


def _own(node: Node, endpoints: Iterable[TopicEndpointInfo]) -> QoSProfile | None:
    """Return the QoS that a node's own endpoint came to; what it asked for may leave it open."""
    name = node.get_fully_qualified_name()
    return next((item.qos_profile for item in endpoints if name_of(item) == name), None)


def _mismatch(
    other: TopicEndpointInfo, kind: str, offered: QoSProfile, requested: QoSProfile,
) -> str:
    """Return in what an endpoint does not fit; nothing where it does."""
    if other.topic_type != kind:
        return f'{other.topic_type}, not {kind}'
    found, reasons = qos_check_compatible(offered, requested)
    if found != QoSCompatibility.ERROR:
        return ''
    errors = [part.strip().removeprefix('ERROR: ') for part in reasons.split(';')
              if part.strip().startswith('ERROR')]
    return f'with incompatible QoS: {"; ".join(errors)}'
