# SPDX-License-Identifier: Apache-2.0
"""The managed node: a lifecycle node that counts, reports and checks its connections."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
import os
import time
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import State
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.msg import TransitionEvent
from lowsnr_common.core.timeline import in_seconds
from lowsnr_common.core.timeline import StampOrder
from lowsnr_common.core.timeline import Timeline
from lowsnr_common.ros.bringup_line import CHANGE_STATE
from lowsnr_common.ros.bringup_line import STATUS
from lowsnr_common.ros.connections import missing_peer
from lowsnr_common.ros.connections import output_faults
from lowsnr_common.ros.connections import wait_while
from lowsnr_common.ros.diagnostics import Fault
from lowsnr_common.ros.diagnostics import Health
from lowsnr_common.ros.inputs import Input
from lowsnr_common.ros.messages import stamp_key
from lowsnr_common.ros.parameters import declare
from lowsnr_common.ros.process.local_topics import LocalInput
from lowsnr_common.ros.settings_node import SettingsNode
from lowsnr_common.settings.node_settings import NodeSettings
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.qos import QoSProfile

_PEERS_WITHIN_S, _THROTTLE_S = 20.0, 5.0
# Time for the answer to a request for shutdown to arrive.
_ANSWERED_AFTER_S = 0.2
# Reasons of faults.
LATE, SET_BACK, BROKEN = 'late stamp', 'clock set back', 'broken'


class ManagedNode(SettingsNode):
    """
    A lifecycle node that counts what it does and reports it in ``/diagnostics``.

    Subclasses make their publishers and subscriptions in :meth:`on_configure`, subscriptions
    by :meth:`listen`, and put the publishers into ``self.outputs`` with the number of readers
    each must have.
    """

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self.settings = declare(self, NodeSettings)
        self.health = Health()
        self.counts = self.health.counts
        self.active = self.done = self.shut_down = self._connected = False
        self._began = self.settings.lives > 0  # active before, in whatever process
        self.outputs: dict[Any, int] = {}
        self.inputs: list[Input] = []
        self._timelines: dict[str, Timeline] = defaultdict(Timeline)
        self._faults: list[Fault] = []
        self.broken = ''  # what keeps the node from its work, in one line
        self._quiet_until = 0.0
        self._diagnostics = self.create_publisher(DiagnosticArray, STATUS, 10)
        self.bringup.hear(CHANGE_STATE, Transition, self._on_transition)
        self._diagnostics_timer = self.create_timer(1.0, self.report)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Wait for the peers, the first time, then become active."""
        if missing := wait_while(self._missing, _PEERS_WITHIN_S, self.report):
            self.get_logger().error('; '.join([missing, *map(str, self._lasting_faults())]))
            return TransitionCallbackReturn.FAILURE
        self.active = self._began = self._connected = True
        for each in self.inputs:
            each.begin()
        self._report_soon()
        return super().on_activate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave all topics, so that the node can be configured again."""
        for each in self.inputs:
            each.close()
        for publisher in self.outputs:
            self.destroy_lifecycle_publisher(publisher)
        for timer in {*self.timers} - {self._diagnostics_timer}:
            self.destroy_timer(timer)
        self.inputs, self.outputs, self._connected = [], {}, False
        return super().on_cleanup(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop answering, and report the last counts."""
        self.active = False
        self.report()
        self._report_soon()
        return super().on_deactivate(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop answering, and end the process once the request has been answered."""
        self.active, self.shut_down = False, True
        self.create_timer(_ANSWERED_AFTER_S, self._end)
        return super().on_shutdown(state)

    def listen(
        self, kind: type, topic: str, callback: Callable[[Any], None], qos: QoSProfile,
        needed: bool = True, steady: bool = True, first: Input | None = None,
    ) -> Input:
        """
        Subscribe to a topic; a message whose callback raises ValueError is rejected with that.

        Parameters
        ----------
        kind, topic, callback, qos
            As for any subscription.
        needed
            Whether it must have a writer before the node becomes active, and while it is.
        steady
            Whether every frame brings a message, so that silence is a fault.
        first
            An input whose queue is emptied before each message of this one.  By itself a node
            takes one message of each input in turn, so that after a stall an input with several
            messages a frame would lag behind an input with one.

        """
        make = LocalInput if self.local.offers(self.resolve_topic_name(topic)) else Input
        self.inputs.append(make(self, kind, topic, callback, qos, needed, steady, first))
        return self.inputs[-1]

    def leave(self, *inputs: Input) -> None:
        """End subscriptions whose messages are no longer used."""
        for each in inputs:
            self.inputs.remove(each)
            each.close()

    def frame_readers(self, needed: int) -> int:
        """Return how many readers of frames to wait for: the evaluator leaves during a run."""
        return max(needed - self._began, 0)

    def _missing(self) -> str:
        if self._connected:  # all were there once, and may have done their work since
            return ''
        needed = {each: n + self.settings.observers - self.local.readers(each.topic_name)
                  for each, n in self.outputs.items()}
        inputs = [each.subscription for each in self.inputs if each.awaited]
        waits = self.settings.consumers or self.bringup.connected
        return missing_peer(needed, inputs if waits else [])

    def reject(self, subject: str, reason: str, text: str, number: int = 1) -> None:
        """
        Count and report messages, or parts of one, that the node does not use.

        Parameters
        ----------
        subject, reason, text
            Topic, reason and sentence of the :class:`Fault`.
        number
            How many share the reason.

        """
        fault = Fault(subject, reason, text)
        self.counts['refused'] += 1
        self.counts[fault.key] += number
        self.warn(fault)

    def warn(self, fault: Fault) -> None:
        """Report a fault in the next status, and in the log at most every 5 s."""
        self.health.fault = fault
        # The logger's own throttle takes longer than a message may take in a flood.
        if (now := time.monotonic()) >= self._quiet_until:
            self._quiet_until = now + _THROTTLE_S
            self.get_logger().warning(str(fault))

    def is_new(self, source: str, stamp: Time) -> bool:
        """Return whether a message may be used by its stamp, see Timeline; reject it otherwise."""
        timeline, key = self._timelines[source], stamp_key(stamp)
        newest, order = timeline.newest, timeline.classify(key, time.monotonic())
        if order is StampOrder.LATE:
            self.counts.update(('late', 'refused'))
            self.warn(Fault(
                source, LATE, f'stamp {in_seconds(key)} s is not after {in_seconds(newest)} s'))
        elif order is StampOrder.SET_BACK:
            self.counts['set back'] += 1
            self.health.fault = Fault(
                source, SET_BACK, f'the clock of its stamps was set back from '
                f'{in_seconds(newest)} s to {in_seconds(key)} s; the node continues from there')
            self.get_logger().warning(str(self.health.fault))
        return order is not StampOrder.LATE

    def facts(self) -> dict[str, str]:
        """Return values of the node's own for ``/diagnostics``, by key."""
        return {}

    def report(self) -> None:
        """Publish counts, times and faults."""
        if not self.context.ok():
            return
        faults = self._lasting_faults()
        if faults and faults != self._faults:
            self.get_logger().error('; '.join(map(str, faults)))
        self._faults = faults
        if self.active:
            faults = faults + [fault for each in self.inputs for fault in each.silence()]
        message = DiagnosticArray(status=[self.health.status(
            self.get_fully_qualified_name(), faults,
            {'state': self._state_machine.current_state[1], 'process': str(os.getpid()),
             **self.facts()})])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)
        self.bringup.tell(STATUS, message)

    def _lasting_faults(self) -> list[Fault]:
        faults = [Fault(self.get_name(), BROKEN, self.broken)] if self.broken else []
        faults += [fault for each in self.inputs for fault in each.faults()]
        return faults + [fault for each in self.outputs for fault in output_faults(self, each)]

    def _report_soon(self) -> None:
        """Report once the present transition is complete."""
        def report() -> None:
            self.destroy_timer(timer)
            self.report()
        timer = self.create_timer(0.0, report)

    def _on_transition(self, transition: Transition) -> None:
        """Make the transition that bring-up asks for, and answer with the state after it."""
        self.change_state(transition)
        self.bringup.tell(CHANGE_STATE, TransitionEvent(
            transition=transition, goal_state=State(id=self._state_machine.current_state[0])))

    def finish(self) -> None:
        """End the process: the node has done all its work."""
        self.report()
        self.done = True
        self._end()

    def _end(self) -> None:
        self.context.try_shutdown()

    def autostart(self) -> bool:
        """Configure and activate without a manager, if set so; return False if that fails."""
        done = TransitionCallbackReturn.SUCCESS
        return not self.settings.autostart or (
            self.trigger_configure() == done and self.trigger_activate() == done)
