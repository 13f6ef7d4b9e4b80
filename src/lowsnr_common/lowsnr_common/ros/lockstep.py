"""When a source of frames in lockstep goes on: once its last frame has been scored."""

from __future__ import annotations

from collections.abc import Callable
import time

from diagnostic_msgs.msg import DiagnosticArray
from lowsnr_common.ros.managed_node import ManagedNode
from lowsnr_common.ros.messages import stamp_key
from lowsnr_common.ros.qos import reliable

# Whoever hands frames and truth on to where they are scored: what it had in hand is lost with it.
_ON_THE_WAY = ('/evaluator', '/conditioner')
_LOOK_EVERY_S = 0.5


class Lockstep:
    """
    Calls ``go_on`` when the frame that was sent last has been scored.

    A frame that will not be scored is not waited for without end: not when the evaluator, or
    what stands before it, was started again in the meantime, and not beyond ``patience_s``.

    Parameters
    ----------
    node
        The source of the frames.
    go_on
        Publishes the next frame.
    patience_s
        Longest wait for one frame [s].

    """

    def __init__(
        self, node: ManagedNode, go_on: Callable[[], None], patience_s: float,
    ) -> None:
        self._node, self._go_on, self._patience_s = node, go_on, patience_s
        self._awaited: int | None = None
        self._since_s = 0.0
        depth = reliable(node.settings.queue_depth)
        node.listen(DiagnosticArray, 'scored', self._on_scored, depth)
        node.listen(
            DiagnosticArray, 'restarts', self._on_restart, depth, needed=False, steady=False)
        node.create_timer(_LOOK_EVERY_S, self._look)

    def sent(self, stamp_ns: int) -> None:
        """Wait for the frame with this stamp."""
        self._awaited, self._since_s = stamp_ns, time.monotonic()

    def _on_scored(self, message: DiagnosticArray) -> None:
        if stamp_key(message.header.stamp) == self._awaited:
            self._next()

    def _on_restart(self, message: DiagnosticArray) -> None:
        if any(status.name in _ON_THE_WAY for status in message.status):
            self._next()

    def _look(self) -> None:
        waited_s = time.monotonic() - self._since_s
        if self._awaited is not None and waited_s > self._patience_s:
            self._node.get_logger().warning(
                f'the frame of {self._awaited / 1e9:.9g} s was not scored within '
                f'{self._patience_s:g} s; going on without it')
            self._next()

    def _next(self) -> None:
        if self._node.active and self._awaited is not None:
            self._awaited = None
            self._go_on()
