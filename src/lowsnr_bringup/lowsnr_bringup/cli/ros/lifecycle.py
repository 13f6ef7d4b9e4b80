# SPDX-License-Identifier: Apache-2.0
"""``ros2 lifecycle``: the states of managed nodes, and their transitions."""

from __future__ import annotations

import argparse
from typing import Any

from lifecycle_msgs.srv import ChangeState
from lifecycle_msgs.srv import GetAvailableTransitions
from lifecycle_msgs.srv import GetState
from lowsnr_bringup.cli.ros.client import add_graph_options
from lowsnr_bringup.cli.ros.client import Client
from lowsnr_bringup.cli.ros.client import graph_client


def add_verbs(verbs: Any) -> None:
    """Add the verbs of ``ros2 lifecycle``."""
    nodes = verbs.add_parser('nodes', help='print the managed nodes', allow_abbrev=False)
    add_graph_options(nodes)
    nodes.add_argument(
        '-c', '--count-nodes', action='store_true', help='print only their number')
    nodes.set_defaults(run=list_nodes)
    get = verbs.add_parser('get', help='print the state of nodes', allow_abbrev=False)
    add_graph_options(get)
    get.add_argument('node_name', nargs='?', help='name of the node (default: all)')
    get.set_defaults(run=print_states)
    change = verbs.add_parser('set', help='ask for a transition', allow_abbrev=False)
    add_graph_options(change)
    change.add_argument('node_name', help='name of the node')
    change.add_argument('transition', help='label or number of the transition')
    change.set_defaults(run=change_state)


def list_nodes(options: argparse.Namespace) -> None:
    """Print the names of all managed nodes, or their number."""
    with graph_client(options) as client:
        names = _managed(client)
    for line in [len(names)] if options.count_nodes else names:
        print(line)


def print_states(options: argparse.Namespace) -> None:
    """Print the state of a node, or of all managed nodes."""
    with graph_client(options) as client:
        if options.node_name is not None:
            print(_state(client, client.find_node(options.node_name)))
            return
        for name in _managed(client):
            print(f'{name}: {_state(client, name)}')


def change_state(options: argparse.Namespace) -> None:
    """Make a node change its state."""
    with graph_client(options) as client:
        name = client.find_node(options.node_name)
        answer = client.call(
            GetAvailableTransitions, f'{name}/get_available_transitions',
            GetAvailableTransitions.Request())
        known = [each.transition for each in answer.available_transitions]
        wanted = [each for each in known if options.transition in (each.label, str(each.id))]
        if not wanted:
            raise ValueError('Unknown transition requested, available ones are:' + ''.join(
                f'\n- {each.label} [{each.id}]' for each in known))
        request = ChangeState.Request(transition=wanted[0])
        if not client.call(ChangeState, f'{name}/change_state', request, asked=1).success:
            raise ValueError('Transitioning failed')
        print('Transitioning successful')


def _managed(client: Client) -> list[str]:
    client.discover()
    return client.with_service('get_state', 'lifecycle_msgs/srv/GetState')


def _state(client: Client, name: str) -> str:
    state = client.call(GetState, f'{name}/get_state', GetState.Request()).current_state
    return f'{state.label} [{state.id}]'
