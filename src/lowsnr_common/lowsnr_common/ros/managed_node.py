"""What nodes share: topics' QoS, the managed node with its diagnostics, the one main()."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
import os
import signal
import sys
import time
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from lowsnr_common.core.parent import follow_parent
from lowsnr_common.core.timeline import StampOrder
from lowsnr_common.core.timeline import Timeline
from lowsnr_common.ros.connections import missing_peer
from lowsnr_common.ros.connections import output_faults
from lowsnr_common.ros.diagnostics import Health
from lowsnr_common.ros.inputs import Input
from lowsnr_common.ros.live_parameters import SettingsNode
from lowsnr_common.ros.memory import keep_freed_memory
from lowsnr_common.ros.messages import stamp_key
from lowsnr_common.ros.parameters import declare
from lowsnr_common.settings.node_settings import NodeSettings
import rclpy
from rclpy.clock import Clock
from rclpy.clock import ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.qos import QoSProfile
from rclpy.timer import Timer

_PEERS_WITHIN_S, _THROTTLE_S = 20.0, 5.0
_REPEATS, _REPEATED_S = 40, 0.05
FAILED, USAGE_ERROR, TERMINATED = 1, 2, 128 + signal.SIGTERM


class ManagedNode(SettingsNode):
    """
    A lifecycle node that counts what it does and says it in ``/diagnostics``.

    Subclasses make their publishers and subscriptions in :meth:`on_configure`, subscriptions
    by :meth:`listen`, and put the publishers into ``self.outputs`` with the number of readers
    each must have.
    """

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self.settings = declare(self, NodeSettings)
        self.health = Health()
        self.counts = self.health.counts
        self.active = self.done = False
        self.outputs: dict[Any, int] = {}
        self._inputs: list[Input] = []
        self._timelines: dict[str, Timeline] = defaultdict(Timeline)
        self._faults: list[str] = []
        self.broken = ''  # what keeps the node from its work
        self._quiet_until = 0.0
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._diagnostics_timer = self.create_timer(1.0, self.report)

    def create_timer(
        self, timer_period_sec: float, callback: Callable[[], None], **kwargs: Any,
    ) -> Timer:
        """Create a timer that goes on when the clock of the machine is set back."""
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        return super().create_timer(timer_period_sec, callback, clock=steady, **kwargs)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Wait for the peers, then become active."""
        until = time.monotonic() + _PEERS_WITHIN_S
        while missing := self._missing():
            if time.monotonic() > until:
                self.get_logger().error('; '.join([missing, *self._standing_faults()]))
                return TransitionCallbackReturn.FAILURE
            time.sleep(0.005)
        self.active = True
        for each in self._inputs:
            each.begin()
        self._report_soon()
        return super().on_activate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave all topics, so that the node can be configured anew."""
        for each in self._inputs:
            self.destroy_subscription(each.subscription)
        for publisher in self.outputs:
            self.destroy_lifecycle_publisher(publisher)
        for timer in {*self.timers} - {self._diagnostics_timer}:
            self.destroy_timer(timer)
        self._inputs, self.outputs = [], {}
        return super().on_cleanup(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop answering, and say the last counts."""
        self.active = False
        self.report()
        self._report_soon()
        return super().on_deactivate(state)

    def listen(
        self, kind: type, topic: str, callback: Callable[[Any], None], qos: QoSProfile,
        needed: bool = True, steady: bool = True, first: Input | None = None,
    ) -> Input:
        """
        Subscribe to a topic.

        A message of which the callback raises ValueError is refused with its reason.

        Parameters
        ----------
        kind, topic, callback, qos
            As for any subscription.
        needed
            Whether it must have a writer before the node becomes active, and while it is.
        steady
            Whether every frame brings a message, so that silence is worth a word.
        first
            An input whose waiting messages are taken before each of this one.  By itself a node
            takes one message of each input in turn, so that after a stall an input of several
            messages a frame would lag behind one of a single.

        """
        self._inputs.append(Input(self, kind, topic, callback, qos, needed, steady, first))
        return self._inputs[-1]

    def _missing(self) -> str:
        needed = {each: n + self.settings.observers for each, n in self.outputs.items()}
        inputs = [each.subscription for each in self._inputs if each.awaited]
        return missing_peer(needed, inputs if self.settings.consumers else [])

    def refuse(self, why: str, reason: str = '') -> None:
        """Count a message that is not used, also by its reason, and say why."""
        self.counts['refused'] += 1
        if reason:
            self.counts[reason] += 1
        self.warn(why)

    def warn(self, why: str) -> None:
        """Say what is amiss, in the log at most every 5 s."""
        self.health.trouble = why
        # Not the logger's own throttle, which takes longer than a message may in a flood.
        if (now := time.monotonic()) >= self._quiet_until:
            self._quiet_until = now + _THROTTLE_S
            self.get_logger().warning(why)

    def is_new(self, source: str, stamp: Time) -> bool:
        """Whether a message is to be used by its stamp, see Timeline; refuses it otherwise."""
        timeline, key = self._timelines[source], stamp_key(stamp)
        newest, order = timeline.newest, timeline.classify(key)
        if order is StampOrder.LATE:
            self.counts['late'] += 1
            self.refuse(f'{source}: stamp {key / 1e9:.14g} s is not after {newest / 1e9:.14g} s')
        elif order is StampOrder.SET_BACK:
            self.counts['set back'] += 1
            self.health.trouble = (
                f'{source}: its clock was set back from {newest / 1e9:.14g} s to '
                f'{key / 1e9:.14g} s; going on from there')
            self.get_logger().warning(self.health.trouble)
        return order is not StampOrder.LATE

    def report(self) -> None:
        """Publish counts, times and what is wrong."""
        if not self.context.ok():
            return
        faults = self._standing_faults()
        if faults and faults != self._faults:
            self.get_logger().error('; '.join(faults))
        self._faults = faults
        if self.active:
            faults = faults + [said for each in self._inputs if (said := each.silence())]
        message = DiagnosticArray(status=[self.health.status(
            self.get_fully_qualified_name(), faults,
            {'state': self._state_machine.current_state[1], 'process': str(os.getpid())})])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    def _standing_faults(self) -> list[str]:
        faults = [self.broken] if self.broken else []
        faults += [said for each in self._inputs for said in each.faults()]
        return faults + [said for each in self.outputs for said in output_faults(self, each)]

    def _report_soon(self) -> None:
        """
        Report once the transition under way has been made.

        A node that was started again repeats it, until whoever waits for that has found it.
        """
        repeats = iter(range(_REPEATS if self.settings.lives else 1))

        def report() -> None:
            if next(repeats, None) is None:
                self.destroy_timer(timer)
            else:
                self.report()
        timer = self.create_timer(_REPEATED_S if self.settings.lives else 0.0, report)

    def finish(self) -> None:
        """End the process: all is done."""
        self.report()
        self.done = True
        self.context.try_shutdown()

    def autostart(self) -> bool:
        """Configure and activate without a manager, where so set; False if that fails."""
        done = TransitionCallbackReturn.SUCCESS
        return not self.settings.autostart or (
            self.trigger_configure() == done and self.trigger_activate() == done)


def run(make_node: Callable[[], ManagedNode], args: list[str] | None = None) -> None:
    """
    Start ROS, spin one node, end quietly on Ctrl-C, SIGTERM or when the node is done.

    A setting out of its bounds ends the process with status 2 and one line, SIGTERM with
    status 143, a node that cannot become active with 1.
    """
    follow_parent()
    keep_freed_memory()
    rclpy.init(args=args)
    node = None
    try:
        node = make_node()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        if not node.autostart():
            sys.exit(FAILED)
        executor.spin()
    except ValueError as error:
        if node is not None:
            raise
        print(error, file=sys.stderr)
        sys.exit(USAGE_ERROR)
    except KeyboardInterrupt:
        return
    except ExternalShutdownException:
        pass
    except RuntimeError:
        if rclpy.ok():  # else what was being published when SIGTERM came
            raise
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    if node is None or not node.done:
        sys.exit(TERMINATED)
