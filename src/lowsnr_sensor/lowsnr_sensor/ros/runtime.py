"""What nodes share: topics' QoS, the managed node with its diagnostics, the one main()."""

from __future__ import annotations

from collections import Counter
from collections import defaultdict
from collections import deque
from collections.abc import Callable
from statistics import median
import sys
import time
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue
from lowsnr_sensor.memory import keep_freed_memory
from lowsnr_sensor.node_settings import NodeSettings
from lowsnr_sensor.parent import follow_parent
from lowsnr_sensor.ros.messages import stamp_key
from lowsnr_sensor.ros.params import declare
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy

_FRAME_BYTES = 256 * 2**20
_PEERS_WITHIN_S = 20.0
_THROTTLE_S = 5.0
_TIMED = 1000
USAGE_ERROR = 2


class ManagedNode(LifecycleNode):
    """
    A lifecycle node that counts what it does and says it in ``/diagnostics``.

    Subclasses make their publishers and subscriptions in :meth:`on_configure`, subscriptions
    by :meth:`listen`, and put the publishers into ``self.outputs`` with the number of readers
    each must have.
    """

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self.settings = declare(self, NodeSettings)
        self.counts: Counter[str] = Counter()
        self.active = False
        self.outputs: dict[Any, int] = {}
        self._inputs: list[Any] = []
        self._trouble = ''
        self._newest: dict[str, int] = {}
        # Time that the last messages of each input took.
        self._spent_ms: dict[str, deque[float]] = defaultdict(lambda: deque(maxlen=_TIMED))
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._diagnostics_timer = self.create_timer(1.0, self.report)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Wait for the peers, then become active."""
        until = time.monotonic() + _PEERS_WITHIN_S
        while missing := self._missing_peer():
            if time.monotonic() > until:
                self.get_logger().error(missing)
                return TransitionCallbackReturn.FAILURE
            time.sleep(0.005)
        self.active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop answering, and say the last counts."""
        self.active = False
        self.report()
        return super().on_deactivate(state)

    def listen(
        self, kind: type, topic: str, callback: Callable[[Any], None], qos: QoSProfile,
    ) -> None:
        """Subscribe to a topic that must have a writer before the node becomes active."""
        def timed(message: Any) -> None:
            start = time.perf_counter()
            callback(message)
            self._spent_ms[topic].append(1e3 * (time.perf_counter() - start))
        self._inputs.append(self.create_subscription(kind, topic, timed, qos))

    def _missing_peer(self) -> str:
        """
        Say which reader or writer is not connected yet; nothing where all are.

        Both ends of a connection find each other at their own time, and a reader that has
        not found its writer loses what the writer sends.  So each node looks at both.
        """
        for publisher, consumers in self.outputs.items():
            needed = consumers + self.settings.observers
            if (found := publisher.get_subscription_count()) < needed:
                return f'{publisher.topic_name}: {found} of {needed} readers (see consumers)'
        for subscription in self._inputs if self.settings.consumers else ():
            if not subscription.get_publisher_count():
                return f'{subscription.topic_name}: nobody publishes it'
        return ''

    def refuse(self, why: str) -> None:
        """Count a message that is not used, and say why, at most every 5 s."""
        self.counts['refused'] += 1
        self._trouble = why
        self.get_logger().warning(why, throttle_duration_sec=_THROTTLE_S)

    def is_new(self, source: str, stamp: Time) -> bool:
        """Whether a stamp is later than all before of this source; refuses it otherwise."""
        key, newest = stamp_key(stamp), self._newest.get(source, -1)
        if key > newest:
            self._newest[source] = key
            return True
        self.counts['late'] += 1
        self.refuse(f'{source}: stamp {key / 1e9:.9g} s is not after {newest / 1e9:.9g} s')
        return False

    def report(self) -> None:
        """Publish counts and times; WARN once for trouble since the last report."""
        if not self.context.ok():
            return
        values = {key: str(count) for key, count in sorted(self.counts.items())}
        for topic, spent in self._spent_ms.items():
            values[f'{topic} median [ms]'] = f'{median(spent):.3f}'
            values[f'{topic} longest [ms]'] = f'{max(spent):.3f}'
        level = DiagnosticStatus.WARN if self._trouble else DiagnosticStatus.OK
        status = DiagnosticStatus(
            level=level, name=self.get_fully_qualified_name(), message=self._trouble,
            values=[KeyValue(key=key, value=value) for key, value in values.items()])
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)
        self._trouble = ''

    def autostart(self) -> None:
        """Configure and activate without a manager, where so set."""
        if self.settings.autostart:
            self.trigger_configure()
            self.trigger_activate()


def reliable(depth: int) -> QoSProfile:
    """Return the QoS of everything small: reliable, the last ``depth`` kept."""
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE)


def frame_depth(depth: int, rows: int, cols: int) -> int:
    """Return how many frames are kept: ``depth``, or what 256 MiB hold of large ones."""
    return max(2, min(depth, _FRAME_BYTES // max(1, 4 * rows * cols)))


def any_reliability(depth: int) -> QoSProfile:
    """Return the QoS of a frame reader: takes a reliable or a best-effort camera."""
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_AVAILABLE)


def run(make_node: Callable[[], ManagedNode], args: list[str] | None = None) -> None:
    """
    Start ROS, spin one node, end quietly on Ctrl-C or shutdown.

    A setting out of its bounds ends the process with status 2 and one line.
    """
    follow_parent()
    keep_freed_memory()
    rclpy.init(args=args)
    node = None
    try:
        node = make_node()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        node.autostart()
        executor.spin()
    except ValueError as error:
        if node is not None:
            raise
        print(error, file=sys.stderr)
        sys.exit(USAGE_ERROR)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
