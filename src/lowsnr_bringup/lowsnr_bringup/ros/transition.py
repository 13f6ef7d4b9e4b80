"""A request for a lifecycle transition, repeated until its outcome is known."""

from __future__ import annotations

import time
from typing import Any

from lifecycle_msgs.msg import State
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from lifecycle_msgs.srv import GetState

_TARGETS = {
    Transition.TRANSITION_CONFIGURE: State.PRIMARY_STATE_INACTIVE,
    Transition.TRANSITION_ACTIVATE: State.PRIMARY_STATE_ACTIVE,
    Transition.TRANSITION_DEACTIVATE: State.PRIMARY_STATE_INACTIVE,
}
_ASK_AGAIN_AFTER_S = 2.0


class PendingTransition:
    """
    A request for a transition.

    The middleware may lose an answer if the server has not discovered the client yet.  So after
    a while, and after a rejection, this asks for the state of the node, and that decides.

    Parameters
    ----------
    change, state
        Clients of the node's ``change_state`` and ``get_state`` services.
    transition
        Id of the transition.

    """

    def __init__(self, change: Any, state: Any, transition: int) -> None:
        self._change = change
        self._state = state
        self._request = ChangeState.Request(transition=Transition(id=transition))
        self._target = _TARGETS[transition]
        self._answer: Any = None
        self._found: Any = None
        self._asked = 0.0

    def poll(self) -> bool | None:
        """Return whether the node made the transition; None while that is unknown."""
        rejected = self._answer is not None and self._answer.done()
        if rejected and self._answer.result().success:
            return True
        if self._found is not None and self._found.done():
            if self._found.result().current_state.id == self._target:
                return True
            if rejected:
                return False
            self._answer = self._found = None  # neither made nor rejected: the request is lost
        self._ask(rejected)
        return None

    def _ask(self, rejected: bool) -> None:
        """Ask for the transition, or for the state if no answer to that comes."""
        waited_s = time.monotonic() - self._asked
        if self._answer is None:
            if self._change.service_is_ready():
                self._answer = self._change.call_async(self._request)
                self._asked = time.monotonic()
        elif waited_s > _ASK_AGAIN_AFTER_S or (rejected and self._found is None):
            self._found = self._state.call_async(GetState.Request())
            self._asked = time.monotonic()
