# SPDX-License-Identifier: Apache-2.0
"""A campaign of faults against a run with one detector, drawn from a generator."""

from collections import Counter
from collections import defaultdict
from collections.abc import Callable
import contextlib
import os
import signal
import time

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from graph_client import FUTURE_S
from graph_client import GraphClient
from graph_client import SUBSCRIBED
from graph_runs import GraphRun
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from lowsnr_common.ros.run_records import ChainCounts
from lowsnr_common.ros.run_records import FrameScored
from lowsnr_common.ros.run_records import NodeRestarted
from lowsnr_common.ros.run_records import RESTARTS
from lowsnr_common.ros.run_records import SCORED
from malformed_messages import BY_TYPE
import numpy as np
from rcl_interfaces.msg import Parameter
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.msg import ParameterValue
from rclpy.qos import qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from tally import FAULTS

MODULES = ('sensor_node', 'detector_node', 'tracker_node', 'evaluator_node')
TOPICS = ('/image_raw', '/detections', '/tracks')
GARBAGE, FLOOD, FORGED = 100, 5000, 20
# The kinds of faults, by the name of the method that injects one.
KINDS = ('killed', 'ended', 'stopped', 'hung', 'deactivated', 'garbage', 'flood', 'stranger',
         'forged', 'clock')
# Bytes of `frames.csv` by which a run that goes on grows: about twenty lines.
_GROWN = 1000
_RECOVERED_WITHIN_S = 120.0


class Campaign:
    """
    Injects faults into a run, and measures how soon frames are scored again.

    ``faults`` counts the faults by kind and target, ``recovered_s`` has the times from fault to
    frames that are scored again [s], by kind, and ``late`` counts those that took too long.

    Parameters
    ----------
    run, client, detector, rng
        The run, a client beside it, the name of its detector, and what the targets are drawn
        from.
    set_clock
        Sets the clock of the host to so many hours ahead; None where that is not possible.
    most_stopped_s
        Longest time for which a node is stopped and goes on by itself [s].

    """

    def __init__(
        self, run: GraphRun, client: GraphClient, detector: str, rng: np.random.Generator,
        set_clock: Callable[[float], None] | None = None, most_stopped_s: float = 5.0,
    ) -> None:
        self._run, self.client, self.rng = run, client, rng
        self._operated = ('/sensor', f'/{detector}_detector', '/tracker')
        self._set_clock, self._most_stopped_s = set_clock, most_stopped_s
        self._clock_h = 0.0
        self.faults: Counter[str] = Counter()
        self.recovered_s: dict[str, list[float]] = defaultdict(list)
        self.late: Counter[str] = Counter()
        for topic in TOPICS:
            client.connect(SUBSCRIBED[topic], topic)

    def inject(self, kind: str) -> None:
        """Inject a fault of a kind, and wait until frames are scored again."""
        before = self.faults.total()
        start_s = time.monotonic()
        getattr(self, f'_{kind}')()
        size = self._size()
        while self._size() < size + _GROWN:
            if self._run.process.poll() is not None:
                return  # its end says why
            if time.monotonic() - start_s > _RECOVERED_WITHIN_S:
                self.late[kind] += 1
                return
            self.client.spin(0.05)
        if self.faults.total() > before:
            self.recovered_s[kind].append(time.monotonic() - start_s)

    def _size(self) -> int:
        path = self._run.results / 'frames.csv'
        return path.stat().st_size if path.exists() else 0

    def _count(self, kind: str, target: str) -> None:
        self.faults[f'{target} {kind}'] += 1
        FAULTS[f'campaign: {kind}'] += 1

    def _signal(self, kind: str, number: int) -> int | None:
        """Send a signal to a node; return its process id, None if no node was there."""
        module = str(self.rng.choice(MODULES))
        pid = self._run.nodes().get(module)
        if pid is None:  # not back from the last fault
            return None
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, number)
            self._count(kind, module)
        return pid

    def _killed(self) -> None:
        self._signal('killed', signal.SIGKILL)

    def _ended(self) -> None:
        self._signal('ended', signal.SIGTERM)

    def _hung(self) -> None:
        """Stop a node for good: bring-up is to find that it hangs."""
        pid = self._signal('hung', signal.SIGSTOP)
        self.client.comes(
            lambda: pid not in self._run.nodes().values() or self._run.process.poll() is not None,
            _RECOVERED_WITHIN_S)

    def _stopped(self) -> None:
        pid = self._signal('stopped for a while', signal.SIGSTOP)
        self.client.spin(float(self.rng.uniform(0.2, 1.0)) * self._most_stopped_s)
        if pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)

    def _deactivated(self) -> None:
        """Deactivate a node as an operator does, and activate it again."""
        node = str(self.rng.choice(self._operated))
        service = self.client.node.create_client(ChangeState, f'{node}/change_state')
        try:
            if not self.client.comes(service.service_is_ready, 2.0):
                return
            for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_ACTIVATE):
                answer = service.call_async(ChangeState.Request(
                    transition=Transition(id=transition)))
                self.client.comes(answer.done, 10.0)
            self._count('deactivated', node)
        finally:
            self.client.node.destroy_client(service)

    def _topic(self) -> str:
        return str(self.rng.choice(TOPICS))

    def _garbage(self) -> None:
        """Send messages that no node may use."""
        topic = self._topic()
        found = list(BY_TYPE[SUBSCRIBED[topic]](self.rng).values())
        for _ in range(GARBAGE):
            message = found[int(self.rng.integers(len(found)))]
            message.header.stamp = self.client.next_stamp(topic)
            self.client.send(topic, message, 'campaign: message of garbage')
        self._count('garbage', topic)

    def _flood(self) -> None:
        """Send 5,000 messages of an old stamp within a second."""
        topic = self._topic()
        for number in range(FLOOD):
            self.client.send(topic, SUBSCRIBED[topic](), 'campaign: message of a flood')
            if number % 100 == 99:
                time.sleep(0.02)
        self._count('flood', topic)

    def _stranger(self) -> None:
        """Publish a topic of the run for a moment, with a QoS that does not fit."""
        topic, node = self._topic(), self.client.node
        publisher = node.create_publisher(SUBSCRIBED[topic], topic, qos_profile_sensor_data)
        for _ in range(10):
            publisher.publish(SUBSCRIBED[topic]())
            self.client.spin(0.05)
        node.destroy_publisher(publisher)
        self._count('published by a stranger', topic)

    def _forged(self) -> None:
        """Publish bookkeeping of a run that is not so."""
        topic, message = list(forgeries().items())[int(self.rng.integers(len(forgeries())))]
        publisher = self.client.node.create_publisher(type(message), topic, 10)
        self.client.comes(publisher.get_subscription_count, 5.0)
        for _ in range(FORGED):
            publisher.publish(message)
            self.client.spin(0.02)
        self.client.node.destroy_publisher(publisher)
        self._count('forged', topic)

    def _clock(self) -> None:
        """Set the clock of the host by a day, and the next time back."""
        if self._set_clock is not None:
            self._clock_h = 24.0 - self._clock_h
            self._set_clock(self._clock_h)
            self._count('set', 'clock')


def forgeries() -> dict[str, object]:
    """Return a message for each topic of bookkeeping, by which a stranger could mislead a run."""
    huge = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value='x' * 5000)
    return {
        '/clock': Clock(clock=Time(sec=FUTURE_S)),
        f'/{SCORED}': FrameScored(
            FUTURE_S * 10**9, 10**9, (ChainCounts('sdt', 10**9, 10**9),)).to_message(),
        f'/{RESTARTS}': NodeRestarted('/tracker', 'was forged', 0.0).to_message(),
        '/parameter_events': ParameterEvent(node='/tracker', changed_parameters=[
            Parameter(name='particles', value=huge)]),
        '/diagnostics': DiagnosticArray(status=[DiagnosticStatus(
            name='/tracker', message='\x1b[2J\nbringup.py: all is well')]),
        '/image_raw': Image(header=Header(stamp=Time(sec=FUTURE_S)))}
