"""A lifecycle node that says why it does not change its state, and outlives being asked to."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.lifecycle import LifecycleNode
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn


class SteadyLifecycleNode(LifecycleNode):
    """
    A lifecycle node for long runs.

    rclpy ends a node that is asked for a transition which its state does not allow, and keeps
    quiet about what a transition failed of.
    """

    def __init__(self, name: str, **kwargs: Any) -> None:
        for transition in ('on_configure', 'on_activate', 'on_deactivate'):
            setattr(self, transition, self._explained(getattr(self, transition)))
        super().__init__(name, **kwargs)

    def _explained(
        self, make: Callable[[LifecycleState], TransitionCallbackReturn],
    ) -> Callable[[LifecycleState], TransitionCallbackReturn]:
        def explained(state: LifecycleState) -> TransitionCallbackReturn:
            try:
                return make(state)
            except (OSError, RuntimeError, ValueError) as error:
                self.get_logger().error(' '.join(str(error).split()))
                return TransitionCallbackReturn.FAILURE
        return explained

    # The service calls this by its private name; there is no other way in.
    def _LifecycleNodeMixin__on_change_state(self, request: Any, response: Any) -> Any:
        try:
            return super()._LifecycleNodeMixin__on_change_state(request, response)
        except RuntimeError:
            label = self._state_machine.current_state[1]
            self.get_logger().warning(
                f'a transition that is not allowed while {label} was asked for; refused')
            response.success = False
            return response
