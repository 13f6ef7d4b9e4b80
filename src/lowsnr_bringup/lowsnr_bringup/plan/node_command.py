# SPDX-License-Identifier: Apache-2.0
"""Which nodes share a process, and the command that starts it."""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping
from itertools import chain
from pathlib import Path

from lowsnr_bringup.plan.graph import Node

# Nodes log to the results; ROS would write the same to ~/.ros/log, and needs a home for that.
NO_OTHER_LOGS = '--disable-external-lib-logs'
# The module of a process that several nodes share.
_CHAIN_MODULE = 'lowsnr_bringup.chain_node'


def by_process(nodes: Iterable[Node]) -> list[list[Node]]:
    """Return the nodes of each process; the processes in the order of their first nodes."""
    found: dict[str, list[Node]] = {}
    for node in nodes:
        found.setdefault(node.enclave, []).append(node)
    return list(found.values())


def node_command(
    nodes: Mapping[Node, Mapping[str, object]], parameter_file: Path,
) -> tuple[str, list[str]]:
    """Return module and arguments of the process of one node, or of several."""
    each = []
    for node, overrides in nodes.items():
        own = [*node.arguments, '--ros-args', '--params-file', str(parameter_file)]
        for name, value in overrides.items():
            own += ['-p', f'{name}:={value}']
        for remap in (f'__ns:={node.namespace}',) * bool(node.namespace) + node.remaps:
            own += ['-r', remap]
        each.append(own)
    first = next(iter(nodes))
    of_process = ['--enclave', first.enclave, NO_OTHER_LOGS]
    if not first.process:
        return first.module, [*each[0], *of_process]
    parts = [['--node', node.module, *own] for node, own in zip(nodes, each)]
    return _CHAIN_MODULE, ['--ros-args', *of_process, *chain.from_iterable(parts)]
