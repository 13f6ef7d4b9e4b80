# SPDX-License-Identifier: Apache-2.0
"""The tracker node: ``detections`` in, ``tracks`` out."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.frame_map import overlaps
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Malformed
from lowsnr_common.core.streams import stream
from lowsnr_common.ros import messages
from lowsnr_common.ros.frame_maps import FrameMaps
from lowsnr_common.ros.managed_node import ManagedNode
from lowsnr_common.ros.node_main import run
from lowsnr_common.ros.parameters import declare
from lowsnr_common.ros.qos import reliable
from lowsnr_common.settings.node_settings import FrameSettings
from lowsnr_track.pda_mmpf import PdaMmpf
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn
import scipy.sparse.csgraph  # noqa: F401  (here, so that no frame waits for it)
import scipy.special  # noqa: F401
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray


class TrackerNode(ManagedNode):
    """Answer each array on ``detections`` with the confirmed tracks, or with an empty array."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('tracker', **kwargs)
        self.tracker = declare(self, PdaMmpf, live=True)
        self.live = (self.tracker,)
        self.frames = declare(self, FrameSettings)
        self._tracker_state = self.tracker.init()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Compile the loops, and create publishers and subscription."""
        depth = self.settings.queue_depth
        warm_up(self.tracker)
        self._tracker_state = self.tracker.init()
        self._rng = stream(self.settings.seed, 'tracker')
        self._array = self.create_publisher(
            Detection2DArray, 'tracks', reliable(depth))
        self._odometry = self.create_publisher(Odometry, 'tracks/odometry', reliable(depth))
        self._tentative = self.create_publisher(
            Detection2DArray, 'tracks/tentative', reliable(depth))
        self.outputs = {
            self._array: self.settings.consumers, self._odometry: self.settings.consumers,
            self._tentative: 0}
        self._maps = FrameMaps(self, self.frames.conditioned, self._answer)
        self._map: FrameMap | None = None
        self.listen(
            Detection2DArray, 'detections', self._on_detections, reliable(depth),
            first=self._maps.input)
        return TransitionCallbackReturn.SUCCESS

    def on_set(self) -> None:
        """Continue with the new settings and all tracks."""
        before, (self.tracker,) = self.tracker, self.live
        self._tracker_state = self.tracker.resume(self._tracker_state, before)
        self.get_logger().info(
            f'the new settings apply from frame {self.counts["in"] + 1} on; all tracks are kept')

    def _on_detections(self, message: Detection2DArray) -> None:
        if not self.active or not self.is_new('detections', message.header.stamp):
            return
        self.counts['in'] += 1
        self._maps.take(message)

    def _answer(self, message: Detection2DArray, where: FrameMap | None) -> None:
        """Follow the objects; where a conditioner follows the camera, in the scene."""
        stamp_s = messages.stamp_key(message.header.stamp) / 1e9
        detections, cell = self._estimates(message), self.tracker.sensor.cell_size_m
        if self._tracker_state.stamp_s is not None and stamp_s < self._tracker_state.stamp_s:
            self._tracker_state = self.tracker.restart(self._tracker_state)
        if where is not None:
            self._follow(where)
            detections = [where.in_cells(item, cell) for item in detections]
        self._tracker_state, output = self.tracker.step(
            self._tracker_state, detections, stamp_s, self._rng)
        for reason, number in output.rejected.items():
            self.reject('detections', reason, f'{number} rejected, {reason}', number)
        confirmed, tentative = output.confirmed, output.tentative
        if where is not None:
            confirmed, tentative = (
                [where.in_image(item, cell) for item in items]
                for items in (confirmed, tentative))
        self._publish(confirmed, tentative, message.header)

    def _follow(self, where: FrameMap) -> None:
        """Move the tracks along when the cells moved in the scene; drop them after a cut."""
        by, self._map = where.moved_since(self._map), where
        if not overlaps(by, (where.size[1] // where.binning, where.size[0] // where.binning)):
            self._tracker_state = self.tracker.restart(self._tracker_state)
        elif any(by):
            self._tracker_state = self._tracker_state.moved(by, self.tracker.sensor.cell_size_m)

    def _estimates(self, message: Detection2DArray) -> list[Estimate]:
        """Return the detections of a message, none of a malformed one."""
        try:
            return messages.array_to_estimates(message, self.tracker.sensor.cell_size_m)
        except Malformed as error:
            self.reject('detections', error.reason, f'{error}; treated as an empty array')
            return []

    def _publish(
        self, confirmed: list[Estimate], tentative: list[Estimate], header: Header,
    ) -> None:
        cell = self.tracker.sensor.cell_size_m
        if self.settings.lives:  # a restarted node does not use the ids again
            confirmed, tentative = (
                [replace(item, id=f'{self.settings.lives + 1}.{item.id}') for item in items]
                for items in (confirmed, tentative))
        for item in confirmed:
            self._odometry.publish(messages.estimate_to_odometry(item, header))
        self._array.publish(messages.estimates_to_array(confirmed, header, cell))
        self._tentative.publish(messages.estimates_to_array(tentative, header, cell))
        self.counts['out'] += 1


def warm_up(tracker: PdaMmpf) -> None:
    """Track one detection, so that no frame waits for a compiler."""
    enough = replace(  # for the loop that draws many normal numbers
        tracker, particles=1000, resample_below=1.0, life=replace(tracker.life, birth_density=1.0))
    detection = Estimate(np.zeros(4), np.eye(4), 0.5)
    state, rng = enough.init(), np.random.default_rng(0)
    for frame in range(3):
        state, _ = enough.step(state, [detection], frame * 1e-3, rng)


def preload() -> None:
    """Load the compiled loops of the default settings."""
    warm_up(PdaMmpf())


def main(args: list[str] | None = None) -> None:
    """Entry point of ``ros2 run lowsnr_track tracker_node``."""
    run(TrackerNode, args)


if __name__ == '__main__':
    main()
