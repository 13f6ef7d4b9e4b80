"""The tracker node: ``detections`` in, ``tracks`` out."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from lowsnr_common.core.malformed import Malformed
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.streams import stream
from lowsnr_common.ros import messages
from lowsnr_common.ros.managed_node import ManagedNode
from lowsnr_common.ros.managed_node import run
from lowsnr_common.ros.parameters import declare
from lowsnr_common.ros.qos import reliable
from lowsnr_track.pda_mmpf import PdaMmpf
from lowsnr_track.warm_up import warm_up
from nav_msgs.msg import Odometry
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray


class TrackerNode(ManagedNode):
    """Answer each array on ``detections`` with the confirmed tracks, empty for none."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('tracker', **kwargs)
        self.tracker = declare(self, PdaMmpf, live=True)
        self.live = (self.tracker,)
        self._memory = self.tracker.init()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Create publishers and subscription."""
        depth = self.settings.queue_depth
        warm_up(self.tracker)
        self._memory = self.tracker.init()
        self._rng = stream(self.settings.seed, 'tracker')
        self._array = self.create_publisher(
            Detection2DArray, 'tracks', reliable(depth))
        self._odometry = self.create_publisher(Odometry, 'tracks/odometry', reliable(depth))
        self._tentative = self.create_publisher(
            Detection2DArray, 'tracks/tentative', reliable(depth))
        self.outputs = {
            self._array: self.settings.consumers, self._odometry: self.settings.consumers,
            self._tentative: 0}
        self.listen(
            Detection2DArray, 'detections', self._on_detections, reliable(depth))
        return TransitionCallbackReturn.SUCCESS

    def on_set(self) -> None:
        """Go on with the tracks that there are and the new settings."""
        before, (self.tracker,) = self.tracker, self.live
        self._memory = self.tracker.resume(self._memory, before)
        self.get_logger().info(
            f'in force from frame {self.counts["in"] + 1} on; all tracks are kept')

    def _on_detections(self, message: Detection2DArray) -> None:
        if not self.active or not self.is_new('detections', message.header.stamp):
            return
        self.counts['in'] += 1
        stamp_s = messages.stamp_key(message.header.stamp) / 1e9
        if self._memory.stamp_s is not None and stamp_s < self._memory.stamp_s:
            self._memory = self.tracker.restart(self._memory)
        self._memory, answer = self.tracker.step(
            self._memory, self._entries(message), stamp_s, self._rng)
        for why, number in answer.refused.items():
            self.counts[f'detections {why}'] += number
            self.refuse(f'detections: {number} refused, {why}')
        self._publish(answer.confirmed, answer.tentative, message.header)

    def _entries(self, message: Detection2DArray) -> list[Estimate]:
        """Return the detections, none where they are too many to be true."""
        try:
            return messages.array_to_estimates(message, self.tracker.sensor.cell_size_m)
        except Malformed as error:
            self.refuse(
                f'detections: {error}; answered as if empty', f'detections {error.reason}')
            return []

    def _publish(
        self, confirmed: list[Estimate], tentative: list[Estimate], header: Header,
    ) -> None:
        cell = self.tracker.sensor.cell_size_m
        if self.settings.lives:  # ids of earlier lives are not used again
            confirmed, tentative = (
                [replace(item, id=f'{self.settings.lives + 1}.{item.id}') for item in items]
                for items in (confirmed, tentative))
        for item in confirmed:
            self._odometry.publish(messages.estimate_to_odometry(item, header))
        self._array.publish(messages.estimates_to_array(confirmed, header, cell))
        self._tentative.publish(messages.estimates_to_array(tentative, header, cell))
        self.counts['out'] += 1


def main(args: list[str] | None = None) -> None:
    """Entry point of ``ros2 run lowsnr_track tracker_node``."""
    run(TrackerNode, args)


if __name__ == '__main__':
    main()
