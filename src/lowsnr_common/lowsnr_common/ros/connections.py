# SPDX-License-Identifier: Apache-2.0
"""The other ends of a node's topics: which are missing, and which do not fit, and why."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterable
from collections.abc import Mapping
import time
from typing import Any

from lowsnr_common.ros.diagnostics import Fault
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import qos_check_compatible
from rclpy.qos import QoSCompatibility
from rclpy.qos import QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo

# Reasons of faults.
SEVERAL_PUBLISHERS = 'several publishers'
OTHER_TYPE, OTHER_QOS = 'other type', 'incompatible qos'
# A node whose endpoints are discovered, but not yet its name, for people and as ROS has it.
UNKNOWN_NAME, _NO_NAME = 'a node of unknown name', '_NODE_NAME_UNKNOWN_'
# Names in one line.
_MOST_NAMES = 5
_ACKNOWLEDGED_WITHIN_S, _PIECE_S = 10.0, 0.5
_LOOK_EVERY_S = 0.005


def missing_peer(outputs: Mapping[Any, int], inputs: Iterable[Any]) -> str:
    """
    Return which reader or writer is not connected yet, in one line; nothing if all are.

    The two ends of a connection discover each other at different times, and a reader that has
    not discovered its writer loses what the writer sends.  So each node checks both.

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


def wait_while(missing: Callable[[], str], within_s: float, report: Callable[[], None]) -> str:
    """
    Wait within a transition of a node until nothing is missing.

    Parameters
    ----------
    missing
        Returns what is missing, in one line; nothing if all is there.
    within_s
        Longest wait [s].
    report
        Called once a second, because no timer of the node runs meanwhile.

    Returns
    -------
    str
        What is still missing after that time.

    """
    start_s = reported_s = time.monotonic()
    while lacking := missing():
        now_s = time.monotonic()
        if now_s - start_s > within_s:
            break
        if now_s - reported_s > 1.0:
            reported_s = now_s
            report()
        time.sleep(_LOOK_EVERY_S)
    return lacking


def wait_for_readers(
    publishers: Iterable[Any], within_s: float = _ACKNOWLEDGED_WITHIN_S,
) -> None:
    """
    Wait until every reader has every message, at most so long [s]: a reader may have died.

    It waits in pieces, because a process whose main thread is never scheduled counts as hanging.
    """
    until = time.monotonic() + within_s
    for publisher in publishers:
        while (left_s := until - time.monotonic()) > 0.0 and not publisher.wait_for_all_acked(
                Duration(seconds=min(left_s, _PIECE_S))):
            pass


def input_faults(node: Node, subscription: Any) -> list[Fault]:
    """Return which publishers of a subscription's topic do not fit, and whether several do."""
    topic, connected = subscription.topic_name, subscription.get_publisher_count()
    known = node.count_publishers(topic)
    if known <= connected <= 1:
        return []
    publishers = node.get_publishers_info_by_topic(topic)
    faults = []
    # A node that died stays known for a while after its successor of the same name started.
    if connected > 1 and len({name_of(publisher) for publisher in publishers}) > 1:
        faults.append(Fault(
            topic, SEVERAL_PUBLISHERS, f'{connected} publishers: {_names(publishers)}'))
    if known > connected:
        own = _own(node, node.get_subscriptions_info_by_topic(topic)) or subscription.qos_profile
        kind = type_name(subscription.msg_type)
        faults += [
            Fault(topic, reason, f'cannot receive from {name_of(other)}, which publishes {why}')
            for other in publishers[:_MOST_NAMES]
            for reason, why in _mismatches(other, kind, other.qos_profile, own)]
    return faults


def output_faults(node: Node, publisher: Any) -> list[Fault]:
    """Return which readers of a publisher's topic do not fit, and whether others publish it."""
    return _other_publishers(node, publisher) + _unfit_readers(node, publisher)


def _other_publishers(node: Node, publisher: Any) -> list[Fault]:
    topic, own = publisher.topic_name, node.get_fully_qualified_name()
    if node.count_publishers(topic) <= 1:
        return []
    publishers = node.get_publishers_info_by_topic(topic)
    if all(name_of(each) == own for each in publishers):  # the node before it was restarted
        return []
    return [Fault(
        topic, SEVERAL_PUBLISHERS, f'{len(publishers)} publishers: {_names(publishers)}')]


def _unfit_readers(node: Node, publisher: Any) -> list[Fault]:
    topic = publisher.topic_name
    if node.count_subscribers(topic) <= publisher.get_subscription_count():
        return []
    own = _own(node, node.get_publishers_info_by_topic(topic)) or publisher.qos_profile
    kind = type_name(publisher.msg_type)
    return [
        Fault(topic, reason, f'cannot send to {name_of(other)}, which subscribes to {why}')
        for other in node.get_subscriptions_info_by_topic(topic)[:_MOST_NAMES]
        for reason, why in _mismatches(other, kind, own, other.qos_profile)]


def name_of(endpoint: TopicEndpointInfo) -> str:
    """Return the full name of the node of an endpoint, `UNKNOWN_NAME` until it is discovered."""
    if endpoint.node_name == _NO_NAME:
        return UNKNOWN_NAME
    return f'{endpoint.node_namespace}/{endpoint.node_name}'.replace('//', '/')


def type_name(kind: type) -> str:
    """Return a message class's type as the middleware names it."""
    return f'{kind.__module__.partition(".")[0]}/msg/{kind.__name__}'


def _names(endpoints: Iterable[TopicEndpointInfo]) -> str:
    names = sorted(name_of(endpoint) for endpoint in endpoints)
    more = ', ...' if len(names) > _MOST_NAMES else ''
    return ', '.join(names[:_MOST_NAMES]) + more


def _own(node: Node, endpoints: Iterable[TopicEndpointInfo]) -> QoSProfile | None:
    """Return the QoS in effect of a node's own endpoint; what it asked for may leave it open."""
    name = node.get_fully_qualified_name()
    return next((item.qos_profile for item in endpoints if name_of(item) == name), None)


def _mismatches(
    other: TopicEndpointInfo, kind: str, offered: QoSProfile, requested: QoSProfile,
) -> list[tuple[str, str]]:
    """Return why an endpoint does not fit, as reason and text; nothing if it does."""
    if other.topic_type != kind:
        return [(OTHER_TYPE, f'{other.topic_type}, not {kind}')]
    found, reasons = qos_check_compatible(offered, requested)
    if found != QoSCompatibility.ERROR:
        return []
    errors = [part.strip().removeprefix('ERROR: ') for part in reasons.split(';')
              if part.strip().startswith('ERROR')]
    return [(OTHER_QOS, f'with incompatible QoS: {", ".join(errors)}')]
