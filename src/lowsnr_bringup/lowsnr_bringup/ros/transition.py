# SPDX-License-Identifier: Apache-2.0
"""A request for a lifecycle transition over the line to a node's process."""

from __future__ import annotations

from lifecycle_msgs.msg import State
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.msg import TransitionEvent
from lowsnr_common.core.line import Line
from lowsnr_common.ros.bringup_line import CHANGE_STATE
from rclpy.serialization import serialize_message

_TARGETS = {
    Transition.TRANSITION_CONFIGURE: State.PRIMARY_STATE_INACTIVE,
    Transition.TRANSITION_ACTIVATE: State.PRIMARY_STATE_ACTIVE,
    Transition.TRANSITION_DEACTIVATE: State.PRIMARY_STATE_INACTIVE,
}


class PendingTransition:
    """
    A request for a transition, which a node makes once it gets to it.

    Parameters
    ----------
    line
        Line to the process of the node.
    transition
        Id of the transition.

    """

    def __init__(self, line: Line, transition: int) -> None:
        self._target = _TARGETS[transition]
        self._made: bool | None = None
        line.send(CHANGE_STATE, serialize_message(Transition(id=transition)))

    def answer(self, event: TransitionEvent) -> None:
        """Take the node's answer; it made the transition if it is in the state after it."""
        self._made = event.goal_state.id == self._target

    def poll(self) -> bool | None:
        """Return whether the node made the transition; None while that is unknown."""
        return self._made
