# SPDX-License-Identifier: Apache-2.0
"""The sensor node: it publishes the frames and the truth of a scenario."""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import Any

from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Truth
from lowsnr_common.core.streams import stream
from lowsnr_common.ros import messages
from lowsnr_common.ros.bringup_line import DATA_TIME
from lowsnr_common.ros.connections import wait_for_readers
from lowsnr_common.ros.lockstep import Lockstep
from lowsnr_common.ros.managed_node import ManagedNode
from lowsnr_common.ros.node_main import run
from lowsnr_common.ros.parameters import declare
from lowsnr_common.ros.qos import frame_depth
from lowsnr_common.ros.qos import reliable
from lowsnr_common.settings.node_settings import SimulationSettings
from lowsnr_sensor.scenario import load_scenario
from lowsnr_sensor.simulator import fluctuating
from lowsnr_sensor.simulator import simulate_frame
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray

FRAME_ID = 'sensor'
_AT_ONCE_S = 1e-4


class SensorNode(ManagedNode):
    """
    Publish ``image_raw``, ``ground_truth``, ``ground_truth/odometry`` and ``/clock``.

    Frame k carries the stamp k T.  The node publishes frames at ``rate_hz`` of the wall clock; in
    lockstep it publishes the next frame when the evaluator has scored those before.  After the
    last frame it ends its process.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('sensor', **kwargs)
        self.simulation = declare(self, SimulationSettings)
        model = self.simulation.sensor
        self.scenario = load_scenario(
            Path(self.simulation.scenario), model.frame_period_s, model.cell_size_m)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Draw the truth and create the publishers."""
        depth, model = self.settings.queue_depth, self.simulation.sensor
        # Note: the noise of a restarted node differs from that of an uninterrupted run.
        self._noise = stream(self.settings.seed, 'noise', self.settings.lives)
        drawn = stream(self.settings.seed, 'truth')
        self._truth = fluctuating(
            self.scenario.truth(model.frame_period_s, model.cell_size_m, drawn), model, drawn)
        last = self.simulation.frames or self.scenario.frames
        first = 1 + max(0, round(self.simulation.resume_after_ns / 1e9 / model.frame_period_s))
        self._frames = iter(count(first) if self.simulation.loop else range(first, last + 1))
        self._image = self.create_publisher(
            Image, 'image_raw', reliable(frame_depth(depth, *self.scenario.shape)))
        self._array = self.create_publisher(
            Detection2DArray, 'ground_truth', reliable(depth))
        self._odometry = self.create_publisher(
            Odometry, 'ground_truth/odometry', reliable(depth))
        self._data_time = self.create_publisher(Clock, DATA_TIME, reliable(depth))
        self.outputs = {
            self._image: self.frame_readers(self.settings.consumers),
            self._array: bool(self.settings.consumers),
            self._odometry: bool(self.settings.consumers), self._data_time: 0}
        self._lockstep = Lockstep(
            self, self._publish_next, self.simulation.patience_s, self.simulation.lag)
        self._prepare()
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start publishing once all subscribers are present."""
        result = super().on_activate(state)
        if self.active:
            self._timer = self.create_timer(_AT_ONCE_S, self._begin)
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop publishing."""
        self.destroy_timer(self._timer)
        return super().on_deactivate(state)

    def _begin(self) -> None:
        """Publish the first frame, and have the next ones published at their rate."""
        self.destroy_timer(self._timer)
        if not self.simulation.lockstep:
            self._timer = self.create_timer(1.0 / self.simulation.rate_hz, self._publish_next)
        self._publish_next()

    def _prepare(self) -> None:
        """Simulate the next frame while the graph processes the last one."""
        k = next(self._frames, None)
        self._next: tuple[int, list[Truth], np.ndarray] | None = None
        if k is not None:
            objects = self._truth[(k - 1) % len(self._truth)]
            self._next = k, objects, simulate_frame(
                objects, self.simulation.sensor, self.scenario.shape, self._noise)

    def _publish_next(self) -> None:
        if self._next is None:
            self._finish()
            return
        k, objects, frame = self._next
        header = Header(
            stamp=messages.stamp_from_seconds(k * self.simulation.sensor.frame_period_s),
            frame_id=FRAME_ID)
        estimates = [Estimate(o.state, np.zeros((4, 4)), 1.0, o.id) for o in objects]
        data_time = Clock(clock=header.stamp)
        try:
            self._data_time.publish(data_time)
            for item in estimates:
                self._odometry.publish(messages.estimate_to_odometry(item, header))
            self._array.publish(messages.estimates_to_array(
                estimates, header, self.simulation.sensor.cell_size_m))
            self._image.publish(messages.frame_to_image(frame, header))
        finally:  # a signal may come between: what reached a reader is told
            self.bringup.tell(DATA_TIME, data_time)  # last: it is not published again
        self.counts['out'] += 1
        self._prepare()
        if self.simulation.lockstep:
            self._lockstep.sent(messages.stamp_key(header.stamp))

    def _finish(self) -> None:
        """End the process once every subscriber has acknowledged every message."""
        wait_for_readers(self.outputs)
        self.finish()


def main(args: list[str] | None = None) -> None:
    """Entry point of ``ros2 run lowsnr_sensor sensor_node``."""
    run(SensorNode, args)


if __name__ == '__main__':
    main()
