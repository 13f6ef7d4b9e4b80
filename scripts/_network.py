# SPDX-License-Identifier: Apache-2.0
"""Who can communicate with the nodes of a run: domain, discovery and security."""

import argparse
import os
from pathlib import Path
import socket


def set_environment(options: argparse.Namespace) -> None:
    """Set the ROS domain and how far it reaches, here and for all nodes."""
    if options.peers:
        os.environ.pop('ROS_LOCALHOST_ONLY', None)  # the older variable would take precedence
    if options.peers == ['subnet']:
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'SUBNET'
    elif options.peers:
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
        os.environ['ROS_STATIC_PEERS'] = ';'.join(options.peers)
    elif not os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE'):  # ROS takes an empty one for SUBNET
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    if options.domain_id is not None:
        os.environ['ROS_DOMAIN_ID'] = str(options.domain_id)


def opened(peers: list[str]) -> list[str]:
    """Return a line that says to whom an option opens discovery; ValueError for no host."""
    for name in peers if peers != ['subnet'] else ():
        if name in ('', 'subnet'):
            raise ValueError(f'--peers: {name!r} is no host: name hosts, or subnet alone')
        try:
            socket.gethostbyname(name)
        except OSError as error:
            raise ValueError(f'--peers: {name} has no address: {error.strerror}') from None
    return [f'discovery is open to {", ".join(peers)}: everybody there, and whoever names this '
            'host, can send to the nodes of this run; --secure lets in only who has a key'
            ] if peers else []


def secure(keystore: Path, nodes: list[str], manager: str) -> None:
    """Make all nodes that start from here on enforce security, each in its own enclave."""
    from lowsnr_bringup.ros.bringup_node import check_security
    from lowsnr_bringup.run.security import secured_environment

    os.environ |= secured_environment(keystore, [f'/{manager}', *nodes], os.environ)
    check_security(manager)
