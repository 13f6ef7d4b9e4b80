# SPDX-License-Identifier: Apache-2.0
"""A program beside a graph: it subscribes, publishes, sets parameters and reads diagnostics."""

from collections.abc import Iterable
from contextlib import ExitStack
from functools import partial
import time

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from drain import drain
from lowsnr_common.ros.messages import stamp_key
from lowsnr_common.ros.qos import reliable
from rcl_interfaces.srv import GetParameters
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.parameter import parameter_value_to_python
from ros_nodes import spun_node
from sensor_msgs.msg import Image
from tally import FAULTS
from vision_msgs.msg import Detection2DArray

FUTURE_S = 2**30
SUBSCRIBED = {
    '/image_raw': Image, '/ground_truth': Detection2DArray, '/detections': Detection2DArray,
    '/tracks': Detection2DArray}
# Nodes of a graph with one detector that subscribe to a topic, where there are two.
READERS = {'/image_raw': 2, '/detections': 2}
SECOND = 1_000_000_000
_WITHIN_S = 120.0
_ANSWER_WITHIN_S = 10.0


class GraphClient:
    """
    A node beside a graph, in a context of its own; use it in ``with``.

    Parameters
    ----------
    domain_id
        ROS domain of the graph.
    name
        Name of the node.
    topics
        Topics of the graph that it subscribes to; all of `SUBSCRIBED` unless given.

    """

    def __init__(
        self, domain_id: int, name: str = 'graph_client', topics: Iterable[str] = SUBSCRIBED,
    ) -> None:
        self._within = ExitStack()
        self.node, self._executor = self._within.enter_context(spun_node(name, domain_id))
        self._publishers = {}
        self.reports = {}  # statuses by node
        self.declared = {}  # whether the detector declared anything, by frame number
        self._newest = {}  # stamp by topic [ns]
        self._sent = 0
        self.node.create_subscription(
            DiagnosticArray, '/diagnostics', self._on_diagnostics, reliable(1000))
        self._subscriptions = {
            topic: self.node.create_subscription(
                SUBSCRIBED[topic], topic, partial(self._on_message, topic), reliable(10_000))
            for topic in topics}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._within.close()

    def _on_diagnostics(self, message):
        for status in message.status:
            self.reports.setdefault(status.name, []).append(status)

    def _on_message(self, topic, message):
        stamp = message.header.stamp
        # The graph's stamps are whole seconds; this client's own lie between them.
        if stamp.nanosec == 0 and stamp.sec < FUTURE_S:
            self._newest[topic] = max(self._newest.get(topic, 0), stamp_key(stamp))
            if topic == '/detections':
                self.declared[stamp.sec] = bool(message.detections)

    def spin(self, seconds):
        """Take messages for a while."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def comes(self, condition, within_s):
        """Take messages until a condition holds; return what it returned last."""
        until = time.monotonic() + within_s
        while not (found := condition()) and time.monotonic() < until:
            self._executor.spin_once(timeout_sec=0.05)
        return found

    def wait(self, condition, within_s=_WITHIN_S):
        """Take messages until a condition holds; return what it returned, or fail."""
        found = self.comes(condition, within_s)
        assert found, {node: statuses[-1].message for node, statuses in self.reports.items()}
        return found

    def connect(self, kind, topic):
        """Start to publish a topic, and wait for its readers, of which this may be one."""
        publisher = self.node.create_publisher(kind, topic, reliable(1000))
        self._publishers[topic] = publisher
        readers = READERS.get(topic, 1) + (topic in self._subscriptions)
        self.wait(lambda: publisher.get_subscription_count() >= readers)

    def disconnect(self, topic):
        """Publish a topic no more."""
        if topic in self._publishers:
            self.node.destroy_publisher(self._publishers.pop(topic))

    def send(self, topic, message, fault):
        """Publish a message, or bytes, and count it as a fault of this kind."""
        self._publishers[topic].publish(message)
        FAULTS[fault] += 1

    def next_stamp(self, topic):
        """Return a stamp between those of a topic's newest and next, later than the last."""
        self._sent += 1
        newest = self._newest_of(topic.removesuffix('/odometry'))
        seconds, nanoseconds = divmod(newest + SECOND // 2 + self._sent, SECOND)
        return Time(sec=seconds, nanosec=nanoseconds)

    def newest_s(self, topic):
        """Return the stamp of the newest message of the graph on a topic [s]."""
        return self._newest_of(topic) // SECOND

    def _newest_of(self, topic):
        if topic in self._subscriptions:
            drain(self._subscriptions[topic])
        return self._newest.get(topic, 0)

    def level(self, node):
        """Return the level of a node's newest status; None where there is none yet."""
        return next((status.level for status in self.reports.get(node, [])[-1:]), None)

    def counts(self, node):
        """Return the newest values of a node's status by key."""
        reports = self.reports.get(node, [])
        return {item.key: item.value for status in reports[-1:] for item in status.values}

    def statuses(self, node, *words):
        """Return the statuses of a node whose message has all of these words."""
        return [status for status in self.reports.get(node, [])
                if all(word in status.message for word in words)]

    def call(self, kind, service, request):
        """Return what a service of a node answers."""
        client = self.node.create_client(kind, service)
        self.wait(client.service_is_ready)
        # An answer is lost where the server has not discovered the client yet.
        asked = (client.call_async(request) for _ in range(12))
        future = next(
            future for future in asked if self.comes(future.done, _ANSWER_WITHIN_S))
        self.node.destroy_client(client)
        return future.result()

    def set(self, node, name, value):  # noqa: A003
        """Set a parameter of a node; return whether the node accepted it, and why not."""
        parameter = Parameter(name, value=value).to_parameter_msg()
        result, = self.call(SetParameters, f'{node}/set_parameters', SetParameters.Request(
            parameters=[parameter])).results
        return result.successful, result.reason

    def get(self, node, *names):
        """Return values of parameters of a node."""
        answer = self.call(
            GetParameters, f'{node}/get_parameters', GetParameters.Request(names=names))
        return [parameter_value_to_python(value) for value in answer.values]
