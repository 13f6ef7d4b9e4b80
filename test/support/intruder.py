"""A stranger on the domain of a graph: says what it likes, and hears what the nodes report."""

from collections import Counter
from contextlib import ExitStack
from functools import partial
import time

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from lowsnr_common.ros.inputs import drain
from lowsnr_common.ros.messages import stamp_key
from lowsnr_common.ros.qos import reliable
from onlooker import onlooker
from sensor_msgs.msg import Image
from vision_msgs.msg import Detection2DArray

FUTURE_S = 2**30
HEARD = {
    '/image_raw': Image, '/ground_truth': Detection2DArray, '/detections': Detection2DArray,
    '/tracks': Detection2DArray}
# Nodes of a graph that hear a topic, where they are two.
READERS = {'/image_raw': 2, '/detections': 2}
# Faults that the tests of this session injected, by kind.
INJECTED = Counter()


class Intruder:
    """A node in a context of its own; use it in ``with``."""

    def __init__(self, domain_id, name='intruder'):
        self._within = ExitStack()
        self.node, self._executor = self._within.enter_context(onlooker(name, domain_id))
        self._publishers = {}
        self.reports = {}
        self._newest = {}  # stamp by topic [ns]
        self._sent = 0
        self.node.create_subscription(
            DiagnosticArray, '/diagnostics', self._on_diagnostics, reliable(1000))
        self._heard = {
            topic: self.node.create_subscription(
                kind, topic, partial(self._on_message, topic), reliable(1000))
            for topic, kind in HEARD.items()}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._within.close()

    def _on_diagnostics(self, message):
        for status in message.status:
            self.reports.setdefault(status.name, []).append(status)

    def _on_message(self, topic, message):
        # Its own lie between those of the graph, which are at whole seconds.
        if message.header.stamp.nanosec == 0 and message.header.stamp.sec < FUTURE_S:
            self._newest[topic] = max(
                self._newest.get(topic, 0), stamp_key(message.header.stamp))

    def spin(self, seconds):
        """Hear what comes for a while."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def wait(self, condition, within_s=60.0):
        """Hear what comes until a condition holds; return what it returned."""
        until = time.monotonic() + within_s
        while not (found := condition()):
            assert time.monotonic() < until, 'the condition did not come true'
            self._executor.spin_once(timeout_sec=0.05)
        return found

    def connect(self, kind, topic):
        """Publish a topic, and wait for its readers, of which it may be one."""
        publisher = self.node.create_publisher(kind, topic, reliable(1000))
        self._publishers[topic] = publisher
        readers = READERS.get(topic, 1) + (topic in HEARD)
        self.wait(lambda: publisher.get_subscription_count() >= readers)

    def leave(self, topic):
        """Publish a topic no more."""
        if topic in self._publishers:
            self.node.destroy_publisher(self._publishers.pop(topic))

    def send(self, topic, message, fault):
        """Send a message, or bytes, that are a fault."""
        self._publishers[topic].publish(message)
        INJECTED[fault] += 1

    def next_stamp(self, topic):
        """Return a stamp between those of a topic's newest and next, later than the last."""
        self._sent += 1
        newest = self._newest_of(topic.removesuffix('/odometry'))
        seconds, nanoseconds = divmod(newest + 500_000_000 + self._sent, 1_000_000_000)
        return Time(sec=seconds, nanosec=nanoseconds)

    def newest_s(self, topic):
        """Return the stamp of the newest message of the graph on a topic [s]."""
        return self._newest_of(topic) // 1_000_000_000

    def _newest_of(self, topic):
        if topic in self._heard:
            drain(self._heard[topic])
        return self._newest.get(topic, 0)

    def level(self, node):
        """Return the level of a node's newest status; None where there is none yet."""
        return next((status.level for status in self.reports.get(node, [])[-1:]), None)

    def counts(self, node):
        """Return the newest values of a node's status by key."""
        reports = self.reports.get(node, [])
        return {item.key: item.value for status in reports[-1:] for item in status.values}

    def told(self, node, *words):
        """Return the statuses of a node whose message has all of these words."""
        return [status for status in self.reports.get(node, [])
                if all(word in status.message for word in words)]
