# SPDX-License-Identifier: Apache-2.0
"""The recorder node: writes every topic of the run into a bag, as received over DDS."""

from __future__ import annotations

from functools import partial
import json
from pathlib import Path
import sqlite3
import sys
import time
from typing import Any
from typing import NoReturn

from lowsnr_bringup.bags.recording import CUSTOM_LOSSES
from lowsnr_bringup.bags.recording import CUSTOM_PARAMETERS
from lowsnr_bringup.bags.recording import restarted_bag
from lowsnr_bringup.bags.storage import Topic
from lowsnr_bringup.bags.writer import BagWriter
from lowsnr_bringup.ros.recorded_topic import Info
from lowsnr_bringup.ros.recorded_topic import message_class
from lowsnr_bringup.ros.recorded_topic import offered_qos
from lowsnr_bringup.ros.recorded_topic import RecordedTopic
from lowsnr_common.ros.connections import wait_while
from lowsnr_common.ros.managed_node import ManagedNode
from lowsnr_common.ros.node_main import run
from lowsnr_common.ros.parameters import declare
from lowsnr_common.ros.qos import frame_depth
from lowsnr_common.settings.node_settings import RecorderSettings
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

# Exit codes: the bag was removed, and a restart writes another one; the disk is full or failed.
REMOVED, FAILED = 4, 1
_LOOK_EVERY_S, _SYNC_EVERY_S = 0.1, 0.5
_QUIET_S, _DRAIN_WITHIN_S = 0.2, 5.0
_READY_WITHIN_S, _FIRST_FRAME_WITHIN_S = 20.0, 5.0
_IMAGE = 'sensor_msgs/msg/Image'
# Topics that nodes publish before the recorder is there, like also .../transition_event.
_EARLIER = ('/diagnostics', '/parameter_events', '/rosout')


class RecorderNode(ManagedNode):
    """
    Record every topic that has a publisher, from the moment the recorder finds it.

    Messages are received and written as bytes.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('recorder', **kwargs)
        self.recording = declare(self, RecorderSettings)
        self._bag: BagWriter | None = None
        self._topics: dict[str, RecordedTopic] = {}
        self._rejected: set[str] = set()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the bag, and subscribe to all topics from now on."""
        custom = {}
        if self.recording.run_parameters:
            custom[CUSTOM_PARAMETERS] = Path(self.recording.run_parameters).read_text(
                encoding='utf-8')
        self._bag = BagWriter(
            restarted_bag(Path(self.recording.bag), self.settings.lives), self.recording.storage,
            custom)
        self._topics, self._rejected = {}, set()
        self.create_timer(_LOOK_EVERY_S, self._find_topics)
        self.create_timer(_SYNC_EVERY_S, self._sync)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """
        Wait until every topic is received.

        Publishers wait until they have found the subscriptions of this node, but a subscription
        may find its publisher later, and loses messages until then.  A camera does not wait.
        """
        if missing := wait_while(self._not_received, _READY_WITHIN_S, self.report):
            self.get_logger().error(f'{missing}: the recorder does not receive it')
            return TransitionCallbackReturn.FAILURE
        if self.settings.live and not self.settings.lives:
            self._wait_for_camera()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take the messages that are still arriving, and close the bag."""
        result = super().on_deactivate(state)
        until = time.monotonic() + _DRAIN_WITHIN_S
        quiet, now_ns = time.monotonic(), time.time_ns()
        while time.monotonic() < min(until, quiet + _QUIET_S):
            taken = self._take_waiting()
            # A camera goes on publishing: only what it published before now is waited for.
            if any(not self.settings.live or received_ns < now_ns for received_ns in taken):
                quiet = time.monotonic()
            else:
                time.sleep(0.01)
        self._close()
        return result

    def destroy_node(self) -> None:
        """Close the bag, whatever ends the node."""
        self._close()
        super().destroy_node()

    def _find_topics(self) -> None:
        """Subscribe to topics that are new."""
        for topic in self._topics.values():
            topic.count_publishers()
        for name, types in self.get_topic_names_and_types():
            if name in self._topics or name in self._rejected or self._bag is None:
                continue
            if publishers := self.get_publishers_info_by_topic(name):
                self._subscribe(self._bag, name, types[0], publishers)

    def _not_received(self) -> str:
        """Return a topic with a publisher that its subscription has not found, or ``''``."""
        self._find_topics()
        # A camera may be switched off when the node is restarted.
        if not (self.settings.live and self.settings.lives):
            for name in self.recording.topics:
                if name not in self._topics:
                    return name
        return next((name for name, topic in self._topics.items() if not topic.is_matched()), '')

    def _wait_for_camera(self) -> None:
        """Wait for the first frame of a camera, for a few seconds."""
        until = time.monotonic() + _FIRST_FRAME_WITHIN_S
        while time.monotonic() < until and not all(
                self._topics[name].tally.received for name in self.recording.topics):
            self._take_waiting()
            time.sleep(0.01)

    def _subscribe(
        self, bag: BagWriter, name: str, msgtype: str, publishers: list[TopicEndpointInfo],
    ) -> None:
        try:
            kind = message_class(msgtype, publishers)
            topic = bag.add_topic(
                name, msgtype, [offered_qos(item.qos_profile) for item in publishers])
        except (ImportError, AttributeError, ValueError) as error:
            self._rejected.add(name)
            self.reject(name, 'not recorded', f'not recorded: {error}')
            return
        earlier = (self.settings.live or name in _EARLIER  # a camera publishes before the run
                   or name.endswith('/transition_event'))
        self._topics[name] = RecordedTopic(
            self, name, kind, self._qos_of(msgtype), partial(self._write, topic), not earlier)
        self._topics[name].tally.shared = len(publishers) > 1

    def _qos_of(self, msgtype: str) -> QoSProfile:
        depth = self.settings.queue_depth
        if msgtype == _IMAGE:
            depth = frame_depth(depth, self.recording.rows, self.recording.cols)
        return QoSProfile(
            depth=depth, reliability=ReliabilityPolicy.BEST_AVAILABLE,
            durability=DurabilityPolicy.BEST_AVAILABLE)

    def _write(self, topic: Topic, data: bytes, info: Info) -> None:
        if self._bag is None:
            return
        self.counts['in'] += 1
        try:
            self._bag.write(topic, data, info['received_timestamp'], info['source_timestamp'])
        except (OSError, sqlite3.Error) as error:
            self._give_up(error)

    def _sync(self) -> None:
        if self._bag is None:
            return
        self.counts['lost'] = sum(topic.tally.lost for topic in self._topics.values())
        try:
            self._bag.sync()
        except (OSError, sqlite3.Error) as error:
            self._give_up(error)

    def _take_waiting(self) -> list[int]:
        """Take a message of each topic that has one; return when they were received [ns]."""
        taken = [topic.take() for topic in self._topics.values()]
        return [received_ns for received_ns in taken if received_ns is not None]

    def _close(self) -> None:
        bag, self._bag = self._bag, None
        if bag is None:
            return
        bag.custom[CUSTOM_LOSSES] = json.dumps({
            name: topic.tally.lost for name, topic in self._topics.items() if topic.tally.lost})
        try:
            bag.close()
        except (OSError, sqlite3.Error) as error:
            self._bag = bag
            self._give_up(error)

    def _give_up(self, error: Exception) -> NoReturn:
        """End the process; the bag is readable up to the last sync, unless it was removed."""
        bag, self._bag = self._bag, None
        removed = isinstance(error, FileNotFoundError)
        if bag is not None:
            bag.abort()
            print(f'{bag.folder}: recording failed after {self.counts["in"]} messages: {error}; '
                  'the bag ' + ('was removed' if removed else 'is good up to here'),
                  file=sys.stderr)
        sys.exit(REMOVED if removed else FAILED)


def main(args: list[str] | None = None) -> None:
    """Entry point of ``ros2 run lowsnr_bringup recorder_node``."""
    run(RecorderNode, args)


if __name__ == '__main__':
    main()
