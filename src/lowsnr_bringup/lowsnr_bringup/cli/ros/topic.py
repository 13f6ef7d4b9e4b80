"""``ros2 topic``: which topics there are, what comes on them, how often and how late."""

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
from lowsnr_bringup.cli.ros.client import add_graph_options
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


def add_verbs(verbs: Any) -> None:
    """Add the verbs of ``ros2 topic``."""
    listing = verbs.add_parser('list', help='print the names of all topics', allow_abbrev=False)
    listing.add_argument('-t', '--show-types', action='store_true', help='print the types too')
    listing.add_argument(
        '-c', '--count-topics', action='store_true', help='print only their number')
    listing.add_argument(
        '-a', '--include-hidden-topics', action='store_true', help='hidden topics too')
    listing.add_argument(
        '-v', '--verbose', action='store_true', help='print types and numbers of endpoints')
    info = verbs.add_parser('info', help='print the endpoints of a topic', allow_abbrev=False)
    info.add_argument('topic_name', type=_full, help='name of the topic')
    info.add_argument(
        '-v', '--verbose', action='store_true', help='print node, type and QoS of each')
    echo = verbs.add_parser('echo', help='print the messages of a topic', allow_abbrev=False)
    _add_echo_options(echo)
    rate = verbs.add_parser('hz', help='print the rate of a topic', allow_abbrev=False)
    delay = verbs.add_parser(
        'delay', help='print the time from stamp to arrival', allow_abbrev=False)
    for verb in (rate, delay):
        verb.add_argument('topic_name', type=_full, help='name of the topic')
        verb.add_argument(
            '-w', '--window', type=_above(0), default=10_000, metavar='WINDOW',
            help='number of messages that count (default: 10000)')
    rate.add_argument(
        '--wall-time', action='store_true', help='measure in wall time also with --use-sim-time')
    for verb, run in ((listing, list_topics), (info, print_info), (echo, print_messages),
                      (rate, print_rate), (delay, print_delay)):
        add_graph_options(verb)
        verb.set_defaults(run=run)


def _add_echo_options(echo: argparse.ArgumentParser) -> None:
    echo.add_argument('topic_name', type=_full, help='name of the topic')
    echo.add_argument('message_type', nargs='?', help='type such as std_msgs/msg/String')
    echo.add_argument('--once', action='store_true', help='end after the first message')
    echo.add_argument('--timeout', type=float, metavar='N', help='end after N seconds')
    echo.add_argument(
        '--field', help='print one field, such as pose.pose.position of nav_msgs/msg/Odometry')
    echo.add_argument('--csv', action='store_true', help='print all values in one line')
    echo.add_argument(
        '-f', '--full-length', action='store_true', help='print long arrays and texts whole')
    echo.add_argument(
        '-l', '--truncate-length', type=_above(-1), default=128, metavar='LENGTH',
        help='longest array and text that is printed whole (default: 128)')
    echo.add_argument('--no-arr', action='store_true', help='print no content of arrays')
    echo.add_argument('--no-str', action='store_true', help='print no content of texts')
    echo.add_argument('--flow-style', action='store_true', help='print each message in one line')
    echo.add_argument('--qos-depth', type=_above(0), default=5, metavar='N', help='queue size')
    echo.add_argument('--qos-reliability', choices=('reliable', 'best_effort'))
    echo.add_argument('--qos-durability', choices=('volatile', 'transient_local'))


def _full(name: str) -> str:
    """Return the full name of a topic."""
    return name if name.startswith('/') else f'/{name}'


def _above(least: int) -> Callable[[str], int]:
    """Return an argparse type for whole numbers above one."""
    def convert(text: str) -> int:
        if not text.isdecimal() or int(text) <= least:
            raise argparse.ArgumentTypeError(f'{text!r} is not a whole number above {least}')
        return int(text)
    return convert


def list_topics(options: argparse.Namespace) -> None:
    """Print the names of all topics."""
    with graph_client(options) as client:
        client.discover()
        topics = dict(sorted(client.topics(options.include_hidden_topics).items()))
        counts = {
            'Published topics:': ('publisher', client.node.count_publishers),
            'Subscribed topics:': ('subscriber', client.node.count_subscribers)}
        if options.count_topics:
            print(len(topics))
        elif options.verbose:
            for title, (kind, count) in counts.items():
                print(title)
                for name, types in topics.items():
                    if number := count(name):
                        plural = 's' if number > 1 else ''
                        print(f' * {name} [{", ".join(types)}] {number} {kind}{plural}')
                print()
        else:
            for name, types in topics.items():
                print(f'{name} [{", ".join(types)}]' if options.show_types else name)


def print_info(options: argparse.Namespace) -> None:
    """Print type and endpoints of a topic."""
    name, end = options.topic_name, '\n\n' if options.verbose else '\n'
    with graph_client(options) as client:
        if not client.appears(lambda: name in client.topics(hidden=True)):
            raise LookupError(f"Unknown topic '{name}' {where()}")
        client.discover()
        types = client.topics(hidden=True)[name]
        print(f'Type: {types[0] if len(types) == 1 else types}', end=end)
        for title, endpoints in (
                ('Publisher', client.node.get_publishers_info_by_topic(name)),
                ('Subscription', client.node.get_subscriptions_info_by_topic(name))):
            print(f'{title} count: {len(endpoints)}', end=end)
            for endpoint in endpoints if options.verbose else ():
                print(endpoint, end=end)


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
        client.spin_until(
            lambda: options.once and printed > 0,
            float('inf') if options.timeout is None else options.timeout)


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
