# SPDX-License-Identifier: Apache-2.0
"""The start of a graph: all nodes become active, also those that die or hang meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import time

from lowsnr_bringup.plan.graph import Node
from lowsnr_bringup.plan.parts import Part
from lowsnr_bringup.ros.heard.part_report import ACTIVE
from lowsnr_bringup.ros.heard.part_report import AWAY
from lowsnr_bringup.ros.heard.part_report import CONFIGURED
from lowsnr_bringup.ros.heard.part_report import DONE
from lowsnr_bringup.ros.heard.part_report import ELSEWHERE
from lowsnr_bringup.ros.manager import ACTIVATE
from lowsnr_bringup.ros.manager import CONFIGURE
from lowsnr_bringup.ros.manager import GraphFailure
from lowsnr_bringup.ros.manager import Manager
from lowsnr_bringup.ros.transition import PendingTransition
from lowsnr_bringup.run.processes import NodeProcess
from lowsnr_bringup.run.processes import notify
from lowsnr_bringup.run.processes import ProcessGroup

# Time to make a transition [s]: the first may have to calibrate.
_WITHIN_S = {CONFIGURE: 600.0, ACTIVATE: 30.0}
_VERBS = {CONFIGURE: 'configure', ACTIVATE: 'activate'}
# Bring-up names the nodes that it waits for after this time, and again after twice the time.
_NAME_AFTER_S = 10.0


@dataclass(eq=False)
class _Ascent:
    """
    How far one process of a node has come on its way to be active.

    ``member`` is None where the node runs in another part of the run.  ``asked`` is the transition
    that it has been asked for, 0 for none, and ``since_s`` when.
    """

    node: Node
    member: NodeProcess | None = None
    configured: bool = False
    active: bool = False
    asked: int = 0
    pending: PendingTransition | None = None
    since_s: float = 0.0


class GraphStart:
    """
    Configures all nodes, all at once, and then activates each after those before it.

    A node that has a new process starts from the beginning.  Its subscribers or publishers may
    have waited for it in vain, so that they are asked to become active again.

    Parameters
    ----------
    manager, group
        The client of the nodes' lifecycles, and the processes.
    part
        The nodes.  Those of other parts are waited for; their own bring-up starts them.
    expect_within_s
        Longest wait for another part [s].
    clock
        The time [s].

    """

    def __init__(
        self, manager: Manager, group: ProcessGroup, part: Part,
        expect_within_s: float = float('inf'), clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._manager, self._group, self._clock = manager, group, clock
        self._expected, self._expect_until_s = part.expected, clock() + expect_within_s
        self._ascents = {
            node: _Ascent(node, None if node in part.expected else group.member(node))
            for node in part.nodes}
        self._replaced = False  # whether any node has a new process
        self._waited_for: list[str] = []
        self._since_s, self._name_after_s = clock(), _NAME_AFTER_S

    def run(self) -> bool:
        """
        Wait until all nodes are active; return False if the run is under way without this part.

        The bring-up of a run that is under way may be heard late.  It is the run of this start if
        it waited for all nodes of this part to become active.

        Raises
        ------
        GraphFailure
            If a node rejects a transition or does not make it in time, or another part does not
            come in time.

        """
        while not self.step():
            if self._manager.parts.running and not all(
                    ascent.active for ascent in self._ascents.values() if ascent.member):
                return False
            self._manager.spin(0.02)
        return True

    def step(self) -> bool:
        """Ask the nodes for what they can do next; return whether all are active."""
        for node in self._expected:
            self._look_at(self._ascents[node])
        own = [node for node in self._ascents if node not in self._expected]
        running = [node for node in own if self._runs(node)]
        for node in running:
            self._take_answer(self._ascents[node])
        for node in running:
            self._ask(self._ascents[node])
        for node in own:
            ascent = self._ascents[node]
            self._manager.states[node.path] = (
                ACTIVE if ascent.active else CONFIGURED if ascent.configured else AWAY)
        self._name_waiting()
        return all(ascent.active for ascent in self._ascents.values())

    def _look_at(self, ascent: _Ascent) -> None:
        """Look how far a node of another part has come; one that was away begins anew."""
        state = self._manager.parts.state(ascent.node)
        configured = state in (CONFIGURED, ACTIVE, DONE)
        self._replaced |= ascent.configured and not configured
        ascent.configured, ascent.active = configured, state in (ACTIVE, DONE)
        if state == ELSEWHERE and self._clock() > self._expect_until_s:
            missing = ', '.join(
                node.label for node in self._ascents if node in self._expected
                and self._manager.parts.state(node) == ELSEWHERE)
            raise GraphFailure(
                f'{missing}: expected, but no bring-up that runs them was heard in time '
                '(--expect-within): start it with the same options and domain, and see --peers')

    def _runs(self, node: Node) -> bool:
        """Return whether a node runs; one that died, or has a new process, begins anew."""
        member = self._group.member(node)
        status, ascent = member.process.poll(), self._ascents[node]
        if status == 0 and node.source:
            ascent.active = True  # it has published all of its few frames
        elif status is not None or member is not ascent.member:
            self._replaced = True
            self._ascents[node] = _Ascent(node, member)
        return status is None

    def _ask(self, ascent: _Ascent) -> None:
        """Ask a node for its next transition."""
        if ascent.pending is None and (asked := self._next(ascent)):
            ascent.asked, ascent.since_s = asked, self._clock()
            ascent.pending = self._manager.request(ascent.node, asked)

    def _take_answer(self, ascent: _Ascent) -> None:
        """Look whether a node has made the transition that it was asked for."""
        if ascent.pending is None:
            return
        made, label = ascent.pending.poll(), ascent.node.label
        if made is None:
            if self._clock() - ascent.since_s > (within_s := _WITHIN_S[ascent.asked]):
                raise GraphFailure(
                    f'{label} did not {_VERBS[ascent.asked]} within {within_s:g} s')
            return
        if not made and not (ascent.asked == ACTIVATE and self._replaced):
            raise GraphFailure(f'{label} rejected a change of its state')
        process = self._group.member(ascent.node).process
        self._manager.reports.hear(ascent.node.path, str(process.pid))
        ascent.configured = True
        ascent.active = made and ascent.asked == ACTIVATE
        ascent.asked, ascent.pending = 0, None

    def _next(self, ascent: _Ascent) -> int:
        """Return the transition that a node can be asked for now, 0 for none."""
        if not ascent.configured:
            return int(CONFIGURE)
        all_of_them = list(self._ascents.values())
        before = all_of_them[:all_of_them.index(ascent)]
        ready = (all(each.configured for each in all_of_them)
                 and all(each.active for each in before))
        return int(ACTIVATE) if ready and not ascent.active else 0

    def _name_waiting(self) -> None:
        """Print which nodes bring-up has been waiting for, and for what."""
        waited_for = [
            f'{ascent.node.label} to {_VERBS[ascent.asked]}'
            for ascent in self._ascents.values() if ascent.asked]
        waited_for += [f'{node.label} of another part' for node, ascent in self._ascents.items()
                       if node in self._expected and not ascent.configured]
        now_s = self._clock()
        if waited_for != self._waited_for:
            self._waited_for, self._since_s = waited_for, now_s
            self._name_after_s = _NAME_AFTER_S
        elif waited_for and now_s - self._since_s >= self._name_after_s:
            notify(f'waiting for {", ".join(waited_for)} ({now_s - self._since_s:.0f} s so far)')
            self._name_after_s *= 2.0
