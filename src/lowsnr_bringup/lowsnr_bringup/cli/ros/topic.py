# SPDX-License-Identifier: Apache-2.0
"""``ros2 topic``: which topics there are, what comes on them, how often and how late."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from lowsnr_bringup.cli.ros.client import add_graph_options
from lowsnr_bringup.cli.ros.client import graph_client
from lowsnr_bringup.cli.ros.client import where
from lowsnr_bringup.cli.ros.subscription import print_delay
from lowsnr_bringup.cli.ros.subscription import print_messages
from lowsnr_bringup.cli.ros.subscription import print_rate


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
