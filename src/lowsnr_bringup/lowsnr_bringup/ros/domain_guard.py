# SPDX-License-Identifier: Apache-2.0
"""One run at a time on a ROS domain, whoever started the other one and from where."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
import time

from rclpy.node import Node

# Nodes that were there before are discovered within about 0.15 s.
_DISCOVERED_WITHIN_S = 0.2


class DomainTaken(ValueError):
    """
    Nodes of another run answer on the domain.

    Parameters
    ----------
    domain
        Number of the ROS domain.
    names
        Full names of the nodes.

    """

    def __init__(self, domain: int, names: Iterable[str]) -> None:
        self.names = sorted(names)
        super().__init__(
            f'ROS domain {domain}: nodes of another run answer there ({", ".join(self.names)}): '
            'end it, or choose another domain with --domain-id')


class DomainGuard:
    """
    Looks for nodes of another run by their names.

    Parameters
    ----------
    node
        Bring-up's node.  The time to discover others counts from here.
    paths
        Full names of the nodes of this run, or of the part of it that runs here.

    """

    def __init__(self, node: Node, paths: Iterable[str]) -> None:
        self._node, self._paths = node, {*paths}
        self._own = node.get_fully_qualified_name()
        self._until_s = time.monotonic() + _DISCOVERED_WITHIN_S

    def check_before_start(self) -> None:
        """Raise DomainTaken if any node of these names answers; none of this run has started."""
        while not (names := self._others()) and time.monotonic() < self._until_s:
            time.sleep(0.01)
        self._raise(names)

    def check(self) -> None:
        """Raise DomainTaken if another bring-up answers, which was discovered late."""
        self._raise({name for name in self._others() if name == self._own})

    def _others(self) -> set[str]:
        """Return which names of this run others have."""
        found = Counter(
            f'{space.rstrip("/")}/{name}'
            for name, space in self._node.get_node_names_and_namespaces())
        found[self._own] -= 1
        return {name for name in (*self._paths, self._own) if found[name] > 0}

    def _raise(self, names: set[str]) -> None:
        if names:
            raise DomainTaken(self._node.context.get_domain_id(), names)
