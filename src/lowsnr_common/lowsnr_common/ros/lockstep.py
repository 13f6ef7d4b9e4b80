# SPDX-License-Identifier: Apache-2.0
"""Lockstep: a source publishes a frame once the evaluator has scored those before."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
import time

from diagnostic_msgs.msg import DiagnosticArray
from lowsnr_common.core.timeline import in_seconds
from lowsnr_common.ros.managed_node import ManagedNode
from lowsnr_common.ros.qos import reliable
from lowsnr_common.ros.run_records import FrameScored
from lowsnr_common.ros.run_records import NodeRestarted
from lowsnr_common.ros.run_records import RESTARTS
from lowsnr_common.ros.run_records import SCORED

# The nodes that a frame and its truth pass before they are scored: a frame that is in one of
# them is lost when it dies.
_ON_THE_WAY = ('/evaluator', '/conditioner')
_CHECK_EVERY_S = 0.5
# A frame is lost where it is sent before source and restarted node have discovered each other.
_AFTER_RESTART_S = 2.0


class Lockstep:
    """
    Calls ``go_on`` when all frames that were sent have been scored, but for those of the lag.

    Answers that are late need later frames: so many more are under way.  It gives up frames when
    the evaluator or the conditioner was started again in the meantime, and when ``patience_s``
    has passed, or two seconds where no frame was scored since a restart of these or of the
    source, which may repeat a frame that was scored.

    Parameters
    ----------
    node
        The source of the frames.
    go_on
        Publishes the next frame.
    patience_s
        Longest wait for one frame [s].
    lag
        Frames by which the latest answer is late.

    """

    def __init__(
        self, node: ManagedNode, go_on: Callable[[], None], patience_s: float, lag: int = 0,
    ) -> None:
        self._node, self._go_on = node, go_on
        self._usual_s = self._patience_s = patience_s
        if node.settings.lives:
            self._expect_loss()
        self._lag = lag
        self._awaited: deque[int] = deque()  # stamps of the frames under way
        self._since_s = 0.0
        depth = reliable(node.settings.queue_depth)
        node.listen(DiagnosticArray, SCORED, self._on_scored, depth)
        node.bringup.hear(RESTARTS, DiagnosticArray, self._on_restart)
        node.create_timer(_CHECK_EVERY_S, self._give_up_late)

    def sent(self, stamp_ns: int) -> None:
        """Wait for the frame with this stamp, which was published."""
        self._awaited.append(stamp_ns)
        self._since_s = time.monotonic()
        self._next()

    def _on_scored(self, message: DiagnosticArray) -> None:
        scored = FrameScored.from_message(message)
        self._patience_s = self._usual_s  # frames arrive again, even if late
        if scored.stamp_ns in self._awaited:
            while self._awaited.popleft() != scored.stamp_ns:
                pass  # a frame that was passed is not scored any more
            self._since_s = time.monotonic()
            self._next()

    def _on_restart(self, message: DiagnosticArray) -> None:
        if NodeRestarted.from_message(message).node in _ON_THE_WAY:
            self._expect_loss()
            self._give_up()

    def _expect_loss(self) -> None:
        self._patience_s = min(self._usual_s, _AFTER_RESTART_S)

    def _give_up_late(self) -> None:
        waited_s = time.monotonic() - self._since_s
        if self._awaited and waited_s > self._patience_s:
            self._node.get_logger().warning(
                f'the frame of {in_seconds(self._awaited[0])} s was not scored within '
                f'{self._patience_s:g} s; going on without it')
            self._give_up()

    def _give_up(self) -> None:
        if self._awaited:
            self._awaited.clear()
            self._next()

    def _next(self) -> None:
        if self._node.active and len(self._awaited) <= self._lag:
            self._go_on()
