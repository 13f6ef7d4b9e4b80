# SPDX-License-Identifier: Apache-2.0
"""The node of one tile: ``image_raw`` in, the cells above the threshold out."""

from __future__ import annotations

import sys
from typing import Any

from lowsnr_common.core.records import Malformed
from lowsnr_common.ros import messages
from lowsnr_common.ros.managed_node import ManagedNode
from lowsnr_common.ros.node_main import run
from lowsnr_common.ros.parameters import declare
from lowsnr_common.ros.qos import any_reliability
from lowsnr_common.ros.qos import frame_depth
from lowsnr_common.ros.qos import reliable
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_common.settings.node_settings import TileSettings
from lowsnr_detect.calibration.operating_point import at_operating_point
from lowsnr_detect.calibration.operating_point import curve
from lowsnr_detect.calibration.operating_point import logged_progress
from lowsnr_detect.node.warm_up import warm_up
from lowsnr_detect.parts.cell_detector import CellDetector
from lowsnr_detect.parts.registry import detector_class
from lowsnr_detect.tiles.exceedances import Exceedances
from lowsnr_detect.tiles.exceedances import exceedances_in
from lowsnr_detect.tiles.exceedances import NONE
from lowsnr_detect.tiles.ros.clouds import exceedances_to_cloud
from lowsnr_detect.tiles.tile import divisible
from lowsnr_detect.tiles.tile import tiles_of
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn
from sensor_msgs.msg import Image
from sensor_msgs.msg import PointCloud2


def tile_topic(number: int) -> str:
    """Return the topic of the tile of a number, from 1."""
    return f'exceedances/tile_{number}'


class TileNode(ManagedNode):
    """
    Answer each frame on ``image_raw`` with the exceedances in one tile, on a topic of its own.

    The threshold is that of the whole frame.  Settings are read when the node starts.
    """

    def __init__(self, detector: str, number: int, **kwargs: Any) -> None:
        super().__init__(f'{detector}_{number}', **kwargs)
        self.number, self.operating = number, declare(self, DetectionSettings)
        self.shape = self.operating.rows, self.operating.cols
        self.detector = divisible(declare(self, detector_class(detector)), self.operating)
        self.tile = tiles_of(self.detector, self.shape, declare(self, TileSettings))[number - 1]

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Create publisher and subscription; calibrate."""
        warm_up(self.detector, self.operating)
        self._detector = self._tuned()
        self._memory = self._detector.init(self.tile.shape)
        depth = self.settings.queue_depth
        self._cloud = self.create_publisher(
            PointCloud2, tile_topic(self.number), reliable(depth))
        self.outputs = {self._cloud: self.settings.consumers}
        self.listen(
            Image, 'image_raw', self._on_frame, any_reliability(frame_depth(depth, *self.shape)))
        return TransitionCallbackReturn.SUCCESS

    def _tuned(self) -> CellDetector:
        """Return the detector with the threshold of its operating point in the whole frame."""
        name, log = self.get_name(), self.get_logger().info
        found = curve(
            self.detector, self.shape, progress=logged_progress(name, self.shape, log),
            warn=log) if self.operating.operating_point == 'matched' else None
        return at_operating_point(name, self.detector, self.operating, found, log)

    def _on_frame(self, image: Image) -> None:
        if not self.active or not self.is_new('image_raw', image.header.stamp):
            return
        self.counts['in'] += 1
        self._cloud.publish(exceedances_to_cloud(self._found(image), image.header))
        self.counts['out'] += 1

    def _found(self, image: Image) -> Exceedances:
        """Return the exceedances in a frame, none in one that is rejected."""
        try:
            frame = messages.image_to_frame(image)
            if frame.shape != self.shape:
                raise Malformed(
                    'other size', f'frame of {frame.shape[1]} x {frame.shape[0]} cells, must be '
                    f'{self.shape[1]} x {self.shape[0]}')
        except Malformed as error:
            self.reject('image_raw', error.reason, f'{error}; frame rejected, nothing found in it')
            return NONE
        self._memory, found = exceedances_in(self._detector, self.tile, self._memory, frame)
        return found


def main(detector: str, number: str) -> None:
    """Run the tile of a number, from 1, of a detector."""
    run(lambda: TileNode(detector, int(number)))


if __name__ == '__main__':
    main(sys.argv.pop(1), sys.argv.pop(1))
