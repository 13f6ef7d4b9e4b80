# SPDX-License-Identifier: Apache-2.0
"""The player node: publishes the frames and the truth of a bag, in place of the sensor."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import time
from typing import Any

from builtin_interfaces.msg import Time
from lowsnr_bringup.bags.bag_frames import COMPRESSED
from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.replay import played_frames
from lowsnr_bringup.bags.replay import PlayedFrame
from lowsnr_common.core.records import Malformed
from lowsnr_common.ros import messages
from lowsnr_common.ros.bringup_line import DATA_TIME
from lowsnr_common.ros.connections import wait_for_readers
from lowsnr_common.ros.images import unpacked
from lowsnr_common.ros.lockstep import Lockstep
from lowsnr_common.ros.managed_node import ManagedNode
from lowsnr_common.ros.node_main import run
from lowsnr_common.ros.parameters import declare
from lowsnr_common.ros.qos import frame_depth
from lowsnr_common.ros.qos import reliable
from lowsnr_common.settings.node_settings import PlayerSettings
from nav_msgs.msg import Odometry
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import CompressedImage
from sensor_msgs.msg import Image
from vision_msgs.msg import Detection2DArray

_AT_ONCE_S = 1e-4


class PlayerNode(ManagedNode):
    """
    Publish ``image_raw``, ``camera_info``, ``ground_truth``, its odometry, and ``/clock``.

    The node publishes the bytes that were recorded; it unpacks compressed images.  It publishes a
    frame by the wall clock, at ``rate_hz`` or at the recorded times, or, in lockstep, when the
    evaluator has scored the frame before it.  After the last frame the node ends its process.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('player', **kwargs)
        self.playing = declare(self, PlayerSettings)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the bag and create the publishers."""
        depth, playing = self.settings.queue_depth, self.playing
        self._bag = Bag(Path(playing.bag))
        self._left = playing.frames or -1
        self._compressed = self._bag.topics.get(playing.frames_topic) == COMPRESSED
        self._truth_bag = Bag(Path(playing.truth_bag)) if playing.truth_bag else None
        self._frames = self._after(played_frames(
            self._bag, playing.frames_topic, playing.truth_topic, playing.left_out,
            self._truth_bag))
        self._image = self.create_publisher(
            Image, 'image_raw', reliable(frame_depth(depth, playing.rows, playing.cols)))
        self._info = self.create_publisher(CameraInfo, 'camera_info', reliable(depth))
        self._data_time = self.create_publisher(Clock, DATA_TIME, reliable(depth))
        self.outputs = {
            self._image: self.frame_readers(self.settings.consumers),
            self._data_time: 0}
        if playing.truth_topic:
            self._array = self.create_publisher(
                Detection2DArray, 'ground_truth', reliable(depth))
            self._odometry = self.create_publisher(
                Odometry, 'ground_truth/odometry', reliable(depth))
            self.outputs |= dict.fromkeys(
                (self._array, self._odometry), bool(self.settings.consumers))
        self._lockstep = Lockstep(
            self, self._publish_next, playing.patience_s, playing.lag)
        self._next = next(self._frames, None)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Wait for the subscribers, and publish the first frame."""
        result = super().on_activate(state)
        if self.active:
            self._start_s, self._played = time.monotonic(), 0
            self._first_stamp = self._next.stamp_ns if self._next else 0
            self._timer = self.create_timer(_AT_ONCE_S, self._publish_next)
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop the frames."""
        self.destroy_timer(self._timer)
        return super().on_deactivate(state)

    def _after(self, frames: Iterator[PlayedFrame]) -> Iterator[PlayedFrame]:
        """Yield the frames that this node did not publish before it was restarted."""
        for frame in frames:
            if frame.stamp_ns > self.playing.resume_after_ns:
                yield frame
            else:
                self._left -= 1

    def _publish_next(self) -> None:
        self._timer.cancel()
        frame, self._left = self._next, self._left - 1
        if frame is None or self._left == -1:
            self._finish()
            return
        # The evaluator does not score a frame without truth where there is truth for others.
        scored = frame.truth is not None or not self.playing.truth_topic
        self._publish(frame)
        self._played += 1
        self.counts['out'] += 1
        self._next = next(self._frames, None)
        if self.playing.lockstep and scored:
            self._lockstep.sent(frame.stamp_ns)
        else:
            self._timer.timer_period_ns = round(1e9 * max(_AT_ONCE_S, self._wait_s()))
            self._timer.reset()

    def _wait_s(self) -> float:
        """Return the time until the next frame is due [s]."""
        since_s = time.monotonic() - self._start_s
        if self._next is None or self.playing.lockstep:
            return 0.0
        if self.playing.rate_hz:
            return self._played / self.playing.rate_hz - since_s
        return (self._next.stamp_ns - self._first_stamp) / 1e9 - since_s

    def _publish(self, frame: PlayedFrame) -> None:
        seconds, nanoseconds = divmod(frame.stamp_ns, 1_000_000_000)
        data_time = Clock(clock=Time(sec=seconds, nanosec=nanoseconds))
        try:
            self._data_time.publish(data_time)
            if frame.truth is not None:
                for data in frame.odometry or self._odometry_of(frame.truth.data):
                    self._odometry.publish(data)
                self._array.publish(frame.truth.data)
            if frame.camera_info:
                self._info.publish(frame.camera_info)
            self._image.publish(self._unpacked(frame.image) if self._compressed else frame.image)
        finally:  # a signal may come between: what reached a reader is told
            self.bringup.tell(DATA_TIME, data_time)  # last: it is not played again

    def _unpacked(self, data: bytes) -> Image:
        """Return a compressed image as one that nodes take."""
        return unpacked(deserialize_message(data, CompressedImage))

    def _odometry_of(self, data: bytes) -> list[Odometry]:
        """Return odometry, without velocity, for truth that was recorded without odometry."""
        array = deserialize_message(data, Detection2DArray)
        try:
            entries = messages.array_to_estimates(array, self.playing.cell_size_m)
        except Malformed as error:
            self.reject(self.playing.truth_topic, error.reason, str(error))
            return []
        return [messages.estimate_to_odometry(item, array.header) for item in entries if item.id]

    def _finish(self) -> None:
        """End the process once every subscriber has acknowledged every message."""
        wait_for_readers(self.outputs)
        for note in self._bag.notes:
            self.get_logger().warning(note)
        for bag in filter(None, (self._bag, self._truth_bag)):
            bag.close()
        self.finish()


def main(args: list[str] | None = None) -> None:
    """Entry point of ``ros2 run lowsnr_bringup player_node``."""
    run(PlayerNode, args)


if __name__ == '__main__':
    main()
