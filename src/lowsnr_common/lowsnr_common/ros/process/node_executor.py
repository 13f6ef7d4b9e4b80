# SPDX-License-Identifier: Apache-2.0
"""The executor of a process of nodes: one thread, one wait for all that is ready."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from collections.abc import Coroutine
from typing import Any

from rclpy.executors import ExternalShutdownException
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.utilities import timeout_sec_to_nsec

_Work = Callable[[], Coroutine[Any, Any, None]]


class NodeExecutor(SingleThreadedExecutor):
    """
    Runs the callbacks of nodes one after another, as the executor of rclpy does, in less time.

    That one collects all entities of its nodes before every wait, wraps each callback in a task,
    and wakes itself twice for each.  This one keeps the entities until a node creates or destroys
    one, and calls.  Callbacks must not await anything.  After each wait it takes one message of
    every subscription that has any.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._stale = True
        self._soon: deque[Callable[[], None]] = deque()

    def wake(self) -> None:
        """Collect the entities again: rclpy calls this when one is created or destroyed."""
        self._stale = True
        super().wake()

    def add_node(self, node: Node) -> bool:
        """Run the callbacks of a node too; return whether it is new."""
        self._stale = True
        return bool(super().add_node(node))

    def call_soon(self, call: Callable[[], None]) -> None:
        """Have a function called after the present callback, before anything else."""
        self._soon.append(call)

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait until something is ready, for at most so long [s], and run what is."""
        self._run_soon()
        if self._stale:
            self._collect()
        self._wait(timeout_sec)
        for waitable in self._waitables:
            if waitable.is_ready(self._wait_set):
                self._run(self._take_waitable, waitable)
        ready = self._wait_set.get_ready_entities
        for kind, entities, take in self._kinds:
            for pointer in ready(kind):
                if pointer in entities:
                    self._run(take, entities[pointer])

    def _collect(self) -> None:
        """Collect the entities of all nodes, and make a wait set that holds as many."""
        self._stale = False
        nodes = self.get_nodes()

        def by_pointer(kind: str) -> dict[int, Any]:
            return {each.handle.pointer: each for node in nodes for each in getattr(node, kind)}

        timers, subscriptions, guards, clients, services = map(
            by_pointer, ('timers', 'subscriptions', 'guards', 'clients', 'services'))
        self._waitables = [each for node in nodes for each in node.waitables]
        self._kinds = (
            ('timer', timers, self._take_timer),
            ('subscription', subscriptions, self._take_subscription),
            ('guard_condition', guards, self._take_guard_condition),
            ('client', clients, self._take_client), ('service', services, self._take_service))
        self._own = [self._guard.handle, self._sigint_gc.handle]
        events = sum(each.get_num_entities().num_events for each in self._waitables)
        self._wait_set = rclpy_implementation.WaitSet(
            len(subscriptions), len(guards) + len(self._own), len(timers), len(clients),
            len(services), events, self._context.handle)

    def _wait(self, timeout_sec: float | None) -> None:
        wait_set = self._wait_set
        wait_set.clear_entities()
        for kind, entities, _ in self._kinds:
            add = getattr(wait_set, f'add_{kind}')
            for entity in entities.values():
                add(entity.handle)
        for handle in self._own:
            wait_set.add_guard_condition(handle)
        for waitable in self._waitables:
            waitable.add_to_wait_set(wait_set)
        wait_set.wait(timeout_sec_to_nsec(timeout_sec))
        if not self._context.ok():
            raise ExternalShutdownException

    def _run(self, take: Callable[[Any], _Work | None], entity: Any) -> None:
        """Take what is ready, run the callback, and what that wants to be called soon."""
        work = take(entity)
        if work is not None:
            try:
                work().send(None)
            except StopIteration:
                pass
            else:
                raise RuntimeError('a callback of a node awaits something')
        self._run_soon()

    def _run_soon(self) -> None:
        while self._soon:
            self._soon.popleft()()
