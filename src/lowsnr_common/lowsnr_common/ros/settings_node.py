# SPDX-License-Identifier: Apache-2.0
"""A lifecycle node whose settings can change while it runs, by ``ros2 param set``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from typing import ClassVar

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from lowsnr_common.ros.bringup_line import BringupLine
from lowsnr_common.ros.bringup_line import PARAMETERS
from lowsnr_common.ros.process.local_topics import LocalTopics
from lowsnr_common.settings.flat_values import changed
from lowsnr_common.settings.flat_values import flat_values
from lowsnr_common.settings.text import one_line
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock
from rclpy.clock import ClockType
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.lifecycle import LifecycleNode
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.timer import Timer


class SteadyLifecycleNode(LifecycleNode):
    """
    A lifecycle node that logs why a transition failed, and rejects those it cannot make.

    A node of rclpy itself ends when it is asked for a transition that its state does not allow,
    and logs no reason when a transition fails.
    """

    def __init__(self, name: str, **kwargs: Any) -> None:
        for transition in ('on_configure', 'on_activate', 'on_deactivate'):
            setattr(self, transition, self._explained(getattr(self, transition)))
        super().__init__(name, **kwargs)

    def create_publisher(self, *args: Any, **kwargs: Any) -> Any:
        """
        Create a publisher without the default handlers of events, which log other QoS.

        The node reports readers that do not fit itself, and each handler is looked at before
        every message that the node receives.
        """
        none = PublisherEventCallbacks(use_default_callbacks=False)
        return super().create_publisher(*args, event_callbacks=none, **kwargs)

    def create_timer(
        self, timer_period_sec: float, callback: Callable[[], None], **kwargs: Any,
    ) -> Timer:
        """Create a timer that keeps its period when the clock of the machine is set back."""
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        return super().create_timer(timer_period_sec, callback, clock=steady, **kwargs)

    def _explained(
        self, make: Callable[[LifecycleState], TransitionCallbackReturn],
    ) -> Callable[[LifecycleState], TransitionCallbackReturn]:
        def explained(state: LifecycleState) -> TransitionCallbackReturn:
            try:
                return make(state)
            except (OSError, RuntimeError, ValueError) as error:
                self.get_logger().error(one_line(error))
                return TransitionCallbackReturn.FAILURE
        return explained

    # The service calls this private method; rclpy has no other hook.
    def _LifecycleNodeMixin__on_change_state(self, request: Any, response: Any) -> Any:
        try:
            return super()._LifecycleNodeMixin__on_change_state(request, response)
        except RuntimeError:
            label = self._state_machine.current_state[1]
            self.get_logger().warning(
                f'rejected a request for a transition that the state {label} does not allow')
            response.success = False
            return response

    def change_state(self, transition: Transition) -> None:
        """Make a transition as the service does: one that the state does not allow is rejected."""
        self._LifecycleNodeMixin__on_change_state(
            ChangeState.Request(transition=transition), ChangeState.Response())


class SettingsNode(SteadyLifecycleNode):
    """
    A lifecycle node whose parameters are settings.

    A subclass with settings that may change declares them as live, keeps the instances in
    ``self.live``, and overrides :meth:`on_set`.  ``offers`` names the topics whose messages it
    hands to nodes of its own process, by :meth:`hand_over`, besides publishing them.
    """

    offers: ClassVar[tuple[str, ...]] = ()

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self.live: tuple[Any, ...] = ()
        self.local = LocalTopics(lambda call: call())
        self._full_names: dict[str, str] = {}
        self.bringup = BringupLine(self)

    def share(self, local: LocalTopics) -> None:
        """Hand messages over by these topics, and take them from there, from now on."""
        self.local = local
        self._full_names = {topic: self.resolve_topic_name(topic) for topic in self.offers}
        for full_name in self._full_names.values():
            local.offer(full_name)

    def hand_over(self, topic: str, message: Any) -> None:
        """Hand a message to the nodes of this process that read the topic."""
        if topic in self._full_names:
            self.local.hand_over(self._full_names[topic], message)

    def complete(self, values: dict[str, Any]) -> dict[str, Any]:
        """Return these values and those that change with them; ValueError for a wrong one."""
        return values

    def on_set(self) -> None:
        """Act on the new settings in ``self.live``."""

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """
        Set all parameters, or none and return the reason in one line.

        The parameter services call this for one parameter and for many.
        """
        try:
            live, parameters = self._checked(parameter_list)
        except ValueError as error:
            self.get_logger().warning(f'not set: {one_line(error)}')
            return SetParametersResult(successful=False, reason=str(error))
        result = super().set_parameters_atomically(parameters)
        if result.successful and live != self.live:
            self.get_logger().info('set ' + ', '.join(
                f'{name} = {new} (was {old})' for name, old, new in self._differences(live)))
            self.live = live
            self.on_set()
            # Bring-up gives the values to the node again if it dies and is restarted.
            self.bringup.tell(PARAMETERS, ParameterEvent(
                node=self.get_fully_qualified_name(),
                changed_parameters=[each.to_parameter_msg() for each in parameters]))
        return result

    def destroy_node(self) -> None:
        """Leave the line to bring-up, and ROS."""
        self.bringup.leave()
        super().destroy_node()

    def set_parameters(self, parameter_list: list[Parameter]) -> list[SetParametersResult]:
        """Set parameters one by one, by the same rules."""
        return [self.set_parameters_atomically([item]) for item in parameter_list]

    def _checked(
        self, parameters: list[Parameter],
    ) -> tuple[tuple[Any, ...], list[Parameter]]:
        """Return the settings with these parameters, and the parameters in their own types."""
        given = {item.name: item for item in parameters}
        for name in given:
            self._refuse_read_only(name)
        values = self.complete({name: item.value for name, item in given.items()})
        live = tuple(changed(one, values) for one in self.live)
        own = {name: value for one in live for name, value in flat_values(one).items()}
        return live, [
            Parameter(name, value=own[name]) if name in own else given[name] for name in values]

    def _refuse_read_only(self, name: str) -> None:
        if not self.has_parameter(name):
            raise ValueError(f'{name} is not a parameter of {self.get_name()}')
        if self.describe_parameter(name).read_only:
            label = self.get_name().removesuffix('_detector')
            raise ValueError(
                f'{name} is read-only while {self.get_name()} runs; set it at the start: '
                f'--set {label}.{name}=VALUE')

    def _differences(self, live: tuple[Any, ...]) -> list[tuple[str, Any, Any]]:
        """Return name, present and other value of every setting that differs."""
        pairs = [(flat_values(one), flat_values(other)) for one, other in zip(self.live, live)]
        return [
            (name, old, other[name]) for one, other in pairs for name, old in one.items()
            if other[name] != old]
