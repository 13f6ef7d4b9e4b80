# SPDX-License-Identifier: Apache-2.0
"""``ros2 node``: which nodes there are, and what each publishes, reads and serves."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
import sys
from typing import Any

from lowsnr_bringup.cli.ros.client import add_graph_options
from lowsnr_bringup.cli.ros.client import Client
from lowsnr_bringup.cli.ros.client import graph_client
from rclpy.action import get_action_client_names_and_types_by_node
from rclpy.action import get_action_server_names_and_types_by_node


def add_verbs(verbs: Any) -> None:
    """Add the verbs of ``ros2 node``."""
    every = verbs.add_parser('list', help='print the names of all nodes', allow_abbrev=False)
    add_graph_options(every)
    every.add_argument('-a', '--all', action='store_true', help='hidden nodes too')
    every.add_argument(
        '-c', '--count-nodes', action='store_true', help='print only their number')
    every.set_defaults(run=list_nodes)
    info = verbs.add_parser('info', help='print what a node has', allow_abbrev=False)
    add_graph_options(info)
    info.add_argument('node_name', help='full name of the node')
    info.add_argument('--include-hidden', action='store_true', help='hidden topics too')
    info.set_defaults(run=print_info)


def list_nodes(options: argparse.Namespace) -> None:
    """Print the names of all nodes, or their number."""
    with graph_client(options) as client:
        client.discover()
        names = client.node_names(options.all)
    if len(set(names)) < len(names):
        print('WARNING: Be aware that there are nodes in the graph that share an exact name, '
              'which can have unintended side effects.', file=sys.stderr)
    for line in [len(names)] if options.count_nodes else names:
        print(line)


def print_info(options: argparse.Namespace) -> None:
    """Print subscribers, publishers, services and actions of a node."""
    with graph_client(options) as client:
        full = client.find_node(options.node_name)
        client.discover()
        print(full)
        for title, entries in _tables(client, full).items():
            print(f'  {title}:')
            print('\n'.join(f'    {name}: {", ".join(types)}' for name, types in entries
                            if options.include_hidden or not _is_hidden(name)))


def _tables(client: Client, full: str) -> dict[str, Iterable[tuple[str, list[str]]]]:
    """Return names and types of all that a node has, by kind."""
    space, _, name = full.rpartition('/')
    node, place = client.node, (name, space or '/')
    return {
        'Subscribers': node.get_subscriber_names_and_types_by_node(*place),
        'Publishers': node.get_publisher_names_and_types_by_node(*place),
        'Service Servers': node.get_service_names_and_types_by_node(*place),
        'Service Clients': node.get_client_names_and_types_by_node(*place),
        'Action Servers': get_action_server_names_and_types_by_node(node, *place),
        'Action Clients': get_action_client_names_and_types_by_node(node, *place),
    }


def _is_hidden(name: str) -> bool:
    return any(part.startswith('_') for part in name.split('/'))
