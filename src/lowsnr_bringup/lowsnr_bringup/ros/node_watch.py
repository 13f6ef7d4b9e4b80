# SPDX-License-Identifier: Apache-2.0
"""What bring-up prints about nodes: faults of cameras and results, strangers, their states."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field
import time

from diagnostic_msgs.msg import DiagnosticStatus
from lowsnr_bringup.plan.graph import Node
from lowsnr_bringup.run.processes import notify
from lowsnr_common.ros.connections import OTHER_QOS
from lowsnr_common.ros.connections import OTHER_TYPE
from lowsnr_common.ros.connections import SEVERAL_PUBLISHERS
from lowsnr_common.ros.connections import UNKNOWN_NAME
from lowsnr_common.ros.diagnostics import faults_of
from lowsnr_common.ros.inputs import NO_PUBLISHER
from lowsnr_common.ros.inputs import SILENT
from lowsnr_common.ros.managed_node import BROKEN
from lowsnr_detect.tiles.tile_join import WITHOUT_TILE

# A fault that has not been reported for this long counts as a new one.
_NEW_AFTER_S = 60.0
# Ends of the keys of faults that are due to other programs on the domain.
_OF_STRANGERS = tuple(f' {each}' for each in (SEVERAL_PUBLISHERS, OTHER_TYPE, OTHER_QOS))
_ACTIVE = 'active'
_OF_PUBLISHERS = (*_OF_STRANGERS, f' {NO_PUBLISHER}', f' {SILENT}')
# How long the name of a node may come after its endpoints [s]; one that hides it has none.
_NAMED_WITHIN_S = 10.0
# States that last; a node is in the others for the time of a transition.
_PRIMARY = ('unconfigured', 'inactive', _ACTIVE)


@dataclass
class _FaultPrinter:
    """Prints a fault once for as long as it lasts, by its key."""

    clock: Callable[[], float] = time.monotonic
    _seen_s: dict[str, float] = field(default_factory=dict)

    def update(self, key: str, sentence: str) -> None:
        """Take a fault that is reported now."""
        now_s = self.clock()
        if now_s - self._seen_s.get(key, -_NEW_AFTER_S) >= _NEW_AFTER_S:
            notify(sentence)
        self._seen_s[key] = now_s

    def clear(self) -> None:
        """Forget the faults, so that each counts as a new one."""
        self._seen_s.clear()


class FrameWatch:
    """
    Prints each fault of the node that takes raw frames once, and when a camera's frames return.

    A fault is the same while its subject and reason are.  Those of the publisher are printed if
    it is a camera: a player ends, and :class:`StrangerWatch` prints its rivals.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic, live: bool = True) -> None:
        self._printer, self._live, self._failing = _FaultPrinter(clock), live, False

    def update(self, status: DiagnosticStatus) -> None:
        """Take the node's newest status."""
        failing = self._live and status.level == DiagnosticStatus.ERROR
        if self._failing and not failing:
            notify('frames come again')
            self._printer.clear()
        self._failing = failing
        for key, sentence in faults_of(status).items():
            if key.endswith(f' {BROKEN}'):  # that of an evaluator has a watch of its own
                continue
            if self._live or not key.endswith(_OF_PUBLISHERS):
                self._printer.update(key, sentence)


class StrangerWatch:
    """
    Prints once for each topic of the run that others publish too, or with which they clash.

    An endpoint is discovered before the name of its node is; a sentence without the name waits
    for it, because the one with it would not be printed again.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._printer, self._clock = _FaultPrinter(clock), clock
        self._nameless_s: dict[str, float] = {}

    def update(self, status: DiagnosticStatus) -> None:
        """Take the newest status of a node."""
        for key, sentence in faults_of(status).items():
            if key.endswith(_OF_STRANGERS) and not self._waits(key, sentence):
                self._printer.update(key, sentence)

    def _waits(self, key: str, sentence: str) -> bool:
        """Return whether a name may still be discovered."""
        if UNKNOWN_NAME not in sentence:
            self._nameless_s.pop(key, None)
            return False
        now_s = self._clock()
        return now_s - self._nameless_s.setdefault(key, now_s) < _NAMED_WITHIN_S


class TileWatch:
    """
    Prints which tile of a divided detector is missing, and at the end in how many frames one was.

    ``label`` is the name of the merger for people.
    """

    def __init__(self, label: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._label, self._printer = label, _FaultPrinter(clock)
        self._missed: dict[str, int] = {}  # frames without a tile, by process of the node

    def update(self, status: DiagnosticStatus) -> None:
        """Take the newest status of the node."""
        values = {item.key: item.value for item in status.values}
        self._missed[values['process']] = int(values.get(WITHOUT_TILE, 0))
        for key, sentence in faults_of(status).items():
            if key.endswith(f' {WITHOUT_TILE}'):
                self._printer.update(key, f'{self._label}: {sentence}')

    def sum_up(self) -> None:
        """Print in how many frames a tile was missing, if in any."""
        if count := sum(self._missed.values()):
            frames = '1 frame was' if count == 1 else f'{count} frames were'
            notify(f'{self._label}: {frames} answered without a tile: nothing was declared in its '
                   'cells')


@dataclass
class ResultsWatch:
    """
    Prints when the evaluator cannot write its scores, and when it can again.

    ``fault`` says why not, empty while it can.
    """

    fault: str = ''

    def update(self, status: DiagnosticStatus) -> None:
        """Take the evaluator's newest status."""
        before, self.fault = self.fault, next(
            (text for key, text in faults_of(status).items() if key.endswith(f' {BROKEN}')), '')
        if self.fault and not before:
            notify(self.fault)
        elif before and not self.fault:
            notify('scores are written again')


class NodeWatches:
    """
    The watches over raw frames, the evaluator's results, and tiles that are missing.

    Parameters
    ----------
    nodes
        Those of this host.  A node may have several watches.

    """

    def __init__(self, nodes: Sequence[Node]) -> None:
        self.results = ResultsWatch()
        self._tiles = {node.path: TileWatch(node.label) for node in nodes if node.merges}
        frames = FrameWatch(live=any(node.live for node in nodes))
        taker = [node.path for node in nodes if node.takes_raw][-1:]
        self._all: list[tuple[str, FrameWatch | ResultsWatch | TileWatch]] = [
            *((path, frames) for path in taker), ('/evaluator', self.results),
            *self._tiles.items()]

    def update(self, statuses: dict[str, DiagnosticStatus]) -> None:
        """Take the newest statuses of nodes, by path, out of a dict."""
        newest = {path: statuses.pop(path) for path in {*dict(self._all)} & {*statuses}}
        for path, watch in self._all:
            if path in newest:
                watch.update(newest[path])

    def sum_up(self) -> None:
        """Print what is to be said at the end."""
        for watch in self._tiles.values():
            watch.sum_up()


@dataclass
class StateWatch:
    """
    Prints when a node that was active changes its state, which bring-up never asks for in a run.

    A process that has not been active yet is starting: its states are of no interest.
    """

    _states: dict[tuple[str, str], str] = field(default_factory=dict)

    def update(self, label: str, path: str, process: str, state: str) -> None:
        """
        Take the newest state of a node.

        Parameters
        ----------
        label, path
            Name of the node for people, and its full name.
        process
            Its process id.
        state
            Label of its lifecycle state.

        """
        before = self._states.get((path, process), '')
        if state not in _PRIMARY or state == before or (not before and state != _ACTIVE):
            return
        self._states[path, process] = state
        if state != _ACTIVE:
            steps = 'configure, and then activate' if state == 'unconfigured' else 'activate'
            notify(
                f'{label} is {state}, which bring-up did not ask for: it answers nothing until '
                f'it is active again (ros2 lifecycle set {path} {steps})')
        elif before:
            notify(f'{label} is active again')
