"""The recorder node: every topic of the run into a bag, as it came over DDS."""

from __future__ import annotations

from functools import partial
from importlib import import_module
import json
from pathlib import Path
import sqlite3
import sys
import time
from typing import Any
from typing import NoReturn

from lowsnr_bringup.bags.definitions import type_definition
from lowsnr_bringup.bags.recording import bag_of_life
from lowsnr_bringup.bags.recording import CUSTOM_LOSSES
from lowsnr_bringup.bags.recording import CUSTOM_PARAMETERS
from lowsnr_bringup.bags.recording import Tally
from lowsnr_bringup.bags.settings import RecordingSettings
from lowsnr_bringup.bags.writer import BagWriter
from lowsnr_bringup.ros.bag_qos import offered_qos
from lowsnr_common.ros.managed_node import ManagedNode
from lowsnr_common.ros.managed_node import run
from lowsnr_common.ros.parameters import declare
from lowsnr_common.ros.qos import frame_depth
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy
from rosbags.interfaces import Connection

# With room for another bag, and without.
REMOVED, FAILED = 4, 1
_LOOK_EVERY_S, _SYNC_EVERY_S = 0.1, 0.5
_QUIET_S, _DRAIN_WITHIN_S = 0.2, 5.0
_READY_WITHIN_S, _HEARD_WITHIN_S = 20.0, 5.0
_IMAGE = 'sensor_msgs/msg/Image'
# Topics that nodes send to before the recorder is there, as also to .../transition_event.
_BEGUN = ('/diagnostics', '/parameter_events', '/rosout')


class RecorderNode(ManagedNode):
    """
    Record every topic that anybody publishes, from the moment it is there.

    Messages are taken and written as bytes.  What the middleware dropped shows as a gap in a
    publisher's numbers; where a topic has several publishers, the middleware's own word of
    lost messages counts.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('recorder', **kwargs)
        self.recording = declare(self, RecordingSettings)
        self._bag: BagWriter | None = None

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the bag, and follow the topics from now on."""
        file = Path(self.recording.run_parameters)
        custom = {}
        if self.recording.run_parameters:
            custom[CUSTOM_PARAMETERS] = file.read_text(encoding='utf-8')
        self._bag = BagWriter(
            bag_of_life(Path(self.recording.bag), self.settings.lives), self.recording.storage,
            custom)
        self._tallies: dict[str, Tally] = {}
        self._refused: set[str] = set()
        self._readers: dict[str, tuple[Any, type]] = {}
        self.create_timer(_LOOK_EVERY_S, self._look)
        self.create_timer(_SYNC_EVERY_S, self._sync)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """
        Wait until every topic is received.

        Others wait until they have found this node's readers, but the readers may not have found
        them yet, and then lose messages.  A camera waits for nobody.
        """
        until = time.monotonic() + _READY_WITHIN_S
        while missing := self._not_received():
            if time.monotonic() > until:
                self.get_logger().error(f'{missing}: is not received')
                return TransitionCallbackReturn.FAILURE
            time.sleep(0.01)
        if self.settings.live and not self.settings.lives:
            self._hear_camera()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take what is still on its way, and close the bag."""
        result = super().on_deactivate(state)
        until = time.monotonic() + _DRAIN_WITHIN_S
        quiet, now_ns = time.monotonic(), time.time_ns()
        while time.monotonic() < min(until, quiet + _QUIET_S):
            if self._take_waiting(now_ns):
                quiet = time.monotonic()
            else:
                time.sleep(0.01)
        self._close()
        return result

    def destroy_node(self) -> None:
        """Close the bag, whatever ends the node."""
        self._close()
        super().destroy_node()

    def _look(self) -> None:
        """Subscribe to topics that are new."""
        for name, (subscription, _) in self._readers.items():
            self._tallies[name].shared |= subscription.get_publisher_count() > 1
        for name, types in self.get_topic_names_and_types():
            if name in self._tallies or name in self._refused or self._bag is None:
                continue
            publishers = self.get_publishers_info_by_topic(name)
            if publishers:
                self._subscribe(name, types[0], publishers)

    def _not_received(self) -> str:
        """Return a topic with a publisher that its reader has not found; nothing where none."""
        self._look()
        # A camera may be away when the node is started again.
        if not (self.settings.live and self.settings.lives):
            for name in self.recording.topics:
                if name not in self._readers:
                    return name
        for name, (subscription, _) in self._readers.items():
            publishers = self.get_publishers_info_by_topic(name)
            if subscription.get_publisher_count() < len(publishers):
                return name
        return ''

    def _hear_camera(self) -> None:
        """Wait for its first frame, but not for that of a slow one."""
        until = time.monotonic() + _HEARD_WITHIN_S
        while time.monotonic() < until and not all(
                self._tallies[name].received for name in self.recording.topics):
            self._take_waiting(0)
            time.sleep(0.01)

    def _subscribe(self, name: str, msgtype: str, publishers: list[Any]) -> None:
        try:
            # First: whoever publishes chooses the name, and nothing but message types is imported.
            digest = type_definition(msgtype).digest
            package, _, kind = msgtype.split('/')
            message = getattr(import_module(f'{package}.msg'), kind)
            if {str(item.topic_type_hash) for item in publishers} != {digest}:
                raise ValueError(f'{msgtype}: publishers have another definition of this type')
            assert self._bag is not None
            topic = self._bag.add_topic(
                name, msgtype, [offered_qos(item.qos_profile) for item in publishers])
        except (ImportError, AttributeError, ValueError) as error:
            self._refused.add(name)
            self.refuse(f'{name} is not recorded: {error}')
            return
        begun = (self.settings.live or name in _BEGUN  # a camera was there before
                 or name.endswith('/transition_event'))
        tally = self._tallies[name] = Tally(
            shared=len(publishers) > 1, last=None if begun else 0)
        subscription = self.create_subscription(
            message, name, partial(self._on_message, topic, tally), self._depth_of(msgtype),
            event_callbacks=SubscriptionEventCallbacks(
                message_lost=partial(self._on_lost, tally)), raw=True)
        self._readers[name] = subscription, message

    def _depth_of(self, msgtype: str) -> QoSProfile:
        depth = self.settings.queue_depth
        if msgtype == _IMAGE:
            depth = frame_depth(depth, self.recording.rows, self.recording.cols)
        return QoSProfile(
            depth=depth, reliability=ReliabilityPolicy.BEST_AVAILABLE,
            durability=DurabilityPolicy.BEST_AVAILABLE)

    def _on_message(
        self, topic: Connection, tally: Tally, data: bytes, info: dict[str, int],
    ) -> None:
        if self._bag is None:
            return
        tally.add(info['publication_sequence_number'])
        self.counts['in'] += 1
        try:
            self._bag.write(topic, data, info['received_timestamp'], info['source_timestamp'])
        except (OSError, sqlite3.Error) as error:
            self._give_up(error)

    def _on_lost(self, tally: Tally, event: Any) -> None:
        tally.reported = event.total_count

    def _sync(self) -> None:
        if self._bag is None:
            return
        self.counts['lost'] = sum(tally.lost for tally in self._tallies.values())
        try:
            self._bag.sync()
        except (OSError, sqlite3.Error) as error:
            self._give_up(error)

    def _take_waiting(self, now_ns: int) -> bool:
        """
        Take one message of each topic that has one; whether there was any.

        What came after a time [ns] does not count beside a camera, which goes on.
        """
        taken = False
        for subscription, kind in self._readers.values():
            with subscription.handle:
                found = subscription.handle.take_message(kind, True)
            if found is not None:
                subscription.callback(*found)
                taken |= not self.settings.live or found[1]['received_timestamp'] < now_ns
        return taken

    def _close(self) -> None:
        bag, self._bag = self._bag, None
        if bag is None:
            return
        bag.tell(CUSTOM_LOSSES, json.dumps(
            {name: tally.lost for name, tally in self._tallies.items() if tally.lost}))
        try:
            bag.close()
        except (OSError, sqlite3.Error) as error:
            self._bag = bag
            self._give_up(error)

    def _give_up(self, error: Exception) -> NoReturn:
        """End the process: what was synced is whole, unless it was removed."""
        bag, self._bag = self._bag, None
        if bag is not None:
            bag.abort()
        removed = isinstance(error, FileNotFoundError)
        print(f'{bag and bag.folder}: recording failed after {self.counts["in"]} messages: '
              f'{error}; the bag ' + ('was removed' if removed else 'is good up to here'),
              file=sys.stderr)
        sys.exit(REMOVED if removed else FAILED)


def main(args: list[str] | None = None) -> None:
    """Entry point of ``ros2 run lowsnr_eval recorder_node``."""
    run(RecorderNode, args)


if __name__ == '__main__':
    main()
