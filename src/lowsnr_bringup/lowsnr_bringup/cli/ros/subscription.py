# SPDX-License-Identifier: Apache-2.0
"""What comes on a topic: its messages as text, their rate, and their delay."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from importlib import import_module
from typing import Any

from lowsnr_bringup.cli.arrivals import Delay
from lowsnr_bringup.cli.arrivals import Rate
from lowsnr_bringup.cli.message_text import field_text
from lowsnr_bringup.cli.message_text import selected
from lowsnr_bringup.cli.message_text import TextForm
from lowsnr_bringup.cli.ros.client import Client
from lowsnr_bringup.cli.ros.client import graph_client
from lowsnr_bringup.cli.ros.client import where
from rclpy.clock import Clock
from rclpy.clock import ClockType
from rclpy.qos import DurabilityPolicy
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.time import Time

_PRINT_EVERY_S = 1.0
_DEPTH = 1000  # of the queue of messages that are counted


def print_messages(options: argparse.Namespace) -> None:
    """Print the messages of a topic as they arrive."""
    path = [] if options.field is None else [part for part in options.field.split('.') if part]
    if options.field is not None and not path:
        raise ValueError(f"Invalid field value '{options.field}'")
    form = TextForm(
        None if options.full_length else options.truncate_length, not options.no_arr,
        not options.no_str, options.flow_style)
    printed = 0

    def show(message: Any) -> None:
        nonlocal printed
        if not (options.once and printed):
            printed += 1
            text = field_text(selected(message, path), form, options.csv)
            print(text, end='', flush=True)

    with graph_client(options) as client:
        kind = _type_of(client, options.topic_name, options.message_type)
        qos = _fitting_qos(client, options.topic_name, options.qos_depth,
                           options.qos_reliability, options.qos_durability)
        client.node.create_subscription(kind, options.topic_name, show, qos)
        found = client.spin_until(
            lambda: options.once and printed > 0,
            float('inf') if options.timeout is None else options.timeout)
    if options.once and not found:
        raise TimeoutError(f'{options.topic_name}: no message within {options.timeout:g} s')


def print_rate(options: argparse.Namespace) -> None:
    """Print once a second at which rate the messages of a topic arrive."""
    rate = Rate(options.window)
    wall = Clock(clock_type=ClockType.SYSTEM_TIME)

    def take(_: bytes) -> None:
        clock = wall if options.wall_time else client.node.get_clock()
        rate.add(clock.now().nanoseconds)

    with graph_client(options) as client:
        _follow(client, options, take, rate.text)


def print_delay(options: argparse.Namespace) -> None:
    """Print once a second how long after their stamps the messages of a topic arrive."""
    delay = Delay(options.window)

    def take(data: bytes) -> None:
        message = deserialize_message(data, kind)
        if not hasattr(message, 'header'):
            raise ValueError(f'{options.topic_name}: its messages have no header')
        if now_ns := client.node.get_clock().now().nanoseconds:  # 0: no /clock has arrived yet
            delay.add(now_ns, Time.from_msg(message.header.stamp).nanoseconds)

    with graph_client(options) as client:
        kind = _type_of(client, options.topic_name, None)
        _follow(client, options, take, delay.text)


def _follow(
    client: Client, options: argparse.Namespace, take: Callable[[bytes], None],
    text: Callable[[], str | None],
) -> None:
    """Take the messages of a topic, and print a text once a second if one has arrived."""
    kind = _type_of(client, options.topic_name, None)
    qos = _fitting_qos(client, options.topic_name, _DEPTH)
    arrived = False

    def note(data: bytes) -> None:
        nonlocal arrived
        arrived = True
        take(data)

    client.node.create_subscription(kind, options.topic_name, note, qos, raw=True)
    while True:
        arrived = False
        client.spin_until(lambda: False, _PRINT_EVERY_S)
        if arrived and (now := text()) is not None:
            print(now, flush=True)


def _type_of(client: Client, topic: str, named: str | None) -> Any:
    """Return the type of the messages of a topic, once that has appeared."""
    if named is None:
        if not client.appears(lambda: client.node.count_publishers(topic) > 0
                              and topic in client.topics(hidden=True)):
            raise LookupError(f'topic [{topic}] does not appear to be published {where()}')
        types = client.topics(hidden=True)[topic]
        if len(types) > 1:
            raise ValueError(f"Cannot echo topic '{topic}', as it contains more than one type: "
                             f'[{", ".join(types)}]')
        named, = types
    package, _, name = named.replace('/msg/', '/').partition('/')
    try:
        return getattr(import_module(f'{package}.msg'), name)
    except (ImportError, AttributeError, ValueError):
        raise LookupError(f"The message type '{named}' is invalid: this environment has no such "
                          'message') from None


def _fitting_qos(
    client: Client, topic: str, depth: int, reliability: str | None = None,
    durability: str | None = None,
) -> QoSProfile:
    """Return the QoS that is asked for, where it is; else the strongest that all offer."""
    offered = [each.qos_profile for each in client.node.get_publishers_info_by_topic(topic)]
    reliable = bool(offered) and all(
        each.reliability == ReliabilityPolicy.RELIABLE for each in offered)
    kept = bool(offered) and all(
        each.durability == DurabilityPolicy.TRANSIENT_LOCAL for each in offered)
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.get_from_short_key(
            reliability or ('reliable' if reliable else 'best_effort')),
        durability=DurabilityPolicy.get_from_short_key(
            durability or ('transient_local' if kept else 'volatile')))
