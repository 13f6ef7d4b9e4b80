"""The conditioner node: it turns the frames of a real camera into those detectors expect."""

from __future__ import annotations

from typing import Any

from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Malformed
from lowsnr_common.ros import messages
from lowsnr_common.ros.images import image_to_array
from lowsnr_common.ros.managed_node import ManagedNode
from lowsnr_common.ros.node_main import run
from lowsnr_common.ros.parameters import declare
from lowsnr_common.ros.qos import any_reliability
from lowsnr_common.ros.qos import frame_depth
from lowsnr_common.ros.qos import reliable
from lowsnr_common.settings.node_settings import TruthSettings
from lowsnr_sensor.conditioning.conditioner import ConditioningSettings
from lowsnr_sensor.conditioning.state import ConditionerState
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn
import scipy.ndimage  # noqa: F401  (here, so that the first frame does not wait for it)
import scipy.special  # noqa: F401
from sensor_msgs.msg import Image
from vision_msgs.msg import Detection2DArray

# Before the first frame the size is unknown: the queues are as deep as for frames of this size.
_ASSUMED_SHAPE = (1024, 1024)


class ConditionerNode(ManagedNode):
    """
    Publish each frame on ``image_raw`` conditioned on ``conditioned/image_raw``.

    It also publishes the truth in the coordinates of the conditioned frames, which all nodes
    downstream use.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('conditioner', **kwargs)
        self.conditioning = declare(self, ConditioningSettings)
        self.truth = declare(self, TruthSettings)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Create publishers and subscriptions."""
        depth = self.settings.queue_depth
        frames = frame_depth(depth, *_ASSUMED_SHAPE)
        self._conditioner_state: ConditionerState | None = None
        self._image = self.create_publisher(Image, 'conditioned/image_raw', reliable(frames))
        self.outputs = {self._image: self.settings.consumers}
        if self.truth.truth:
            self._array = self.create_publisher(
                Detection2DArray, 'conditioned/ground_truth', reliable(depth))
            self._odometry = self.create_publisher(
                Odometry, 'conditioned/ground_truth/odometry', reliable(depth))
            self.outputs |= dict.fromkeys(
                (self._array, self._odometry), bool(self.settings.consumers))
            self.listen(
                Odometry, 'ground_truth/odometry', self._on_state, reliable(depth), steady=False)
            self.listen(Detection2DArray, 'ground_truth', self._on_truth, reliable(depth))
        self.listen(Image, 'image_raw', self._on_frame, any_reliability(frames))
        return TransitionCallbackReturn.SUCCESS

    def _on_frame(self, image: Image) -> None:
        if not self.active or not self.is_new('image_raw', image.header.stamp):
            return
        self.counts['in'] += 1
        try:
            frame = image_to_array(image)
            before = self._conditioner_state or self.conditioning.init(frame.shape)
            self._conditioner_state, output = self.conditioning.step(before, frame)
            cells = output.cells
        except Malformed as error:
            if self._conditioner_state is None:
                self.reject('image_raw', error.reason, f'{error}; frame rejected')
                return
            self.reject(
                'image_raw', error.reason, f'{error}; frame rejected, published as zeros')
            cells = np.zeros(
                self.conditioning.size(self._conditioner_state.shape))
        self._image.publish(messages.frame_to_image(cells, image.header))
        self.counts['out'] += 1

    def _on_truth(self, message: Detection2DArray) -> None:
        cell = self.truth.sensor.cell_size_m
        entries = messages.array_to_sound_estimates(message, cell)
        self._array.publish(messages.estimates_to_array(
            [self._in_cells(item) for item in entries], message.header, cell))

    def _on_state(self, message: Odometry) -> None:
        item = self._in_cells(messages.odometry_to_estimate(message, 0.0))
        self._odometry.publish(messages.estimate_to_odometry(item, message.header))

    def _in_cells(self, item: Estimate) -> Estimate:
        """Return an object in the coordinates of the conditioned frame."""
        size, side = self.truth.sensor.cell_size_m, self.conditioning.binning
        state = item.state.copy()
        state[POS] = size * self.conditioning.cells(state[POS] / size)
        state[VEL] /= side
        return Estimate(state, item.cov / side**2, item.score, item.id)


def main(args: list[str] | None = None) -> None:
    """Entry point of ``ros2 run lowsnr_sensor conditioner_node``."""
    run(ConditionerNode, args)


if __name__ == '__main__':
    main()
