"""The detector node: any registered detector between ``image_raw`` and ``detections``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lowsnr_detect.calibration import at_operating_point
from lowsnr_detect.detector import refuse_late_answers
from lowsnr_detect.registry import detector_class
from lowsnr_detect.rehearsal import rehearse
from lowsnr_sensor.malformed import Malformed
from lowsnr_sensor.node_settings import DetectionSettings
from lowsnr_sensor.ros import messages
from lowsnr_sensor.ros.params import declare
from lowsnr_sensor.ros.runtime import any_reliability
from lowsnr_sensor.ros.runtime import frame_depth
from lowsnr_sensor.ros.runtime import ManagedNode
from lowsnr_sensor.ros.runtime import reliable
from lowsnr_sensor.ros.runtime import run
from lowsnr_sensor.streams import stream
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray


class DetectorNode(ManagedNode):
    """Answer each frame on ``image_raw`` with one array on ``detections``, empty for none."""

    def __init__(self, detector: str, **kwargs: Any) -> None:
        super().__init__(f'{detector}_detector', **kwargs)
        self.name = detector
        self.operating = declare(self, DetectionSettings)
        self.detector: Any = declare(self, detector_class(detector))
        refuse_late_answers(self.detector)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Create publishers and subscription; calibrate where the frame size is known."""
        rehearse(self.detector)
        shape = (self.operating.rows, self.operating.cols)
        self._shape: tuple[int, int] | None = None
        self._rng = stream(self.settings.seed, 'detector')
        if all(shape):
            self._start(shape)
        depth = self.settings.queue_depth
        self._array = self.create_publisher(
            Detection2DArray, 'detections', reliable(depth))
        self._odometry = self.create_publisher(Odometry, 'detections/odometry', reliable(depth))
        self.outputs = {
            self._array: self.settings.consumers, self._odometry: bool(self.settings.consumers)}
        self.listen(
            Image, 'image_raw', self._on_frame, any_reliability(frame_depth(depth, *shape)))
        return TransitionCallbackReturn.SUCCESS

    def _start(self, shape: tuple[int, int]) -> None:
        """Set the threshold for frames of this shape and the memory before the first."""
        self._tuned = at_operating_point(
            self.name, self.detector, self.operating, shape, log=self.get_logger().info)
        self._memory = self._tuned.init(shape)
        self._shape = shape

    def _on_frame(self, image: Image) -> None:
        if not self.active or not self.is_new('image_raw', image.header.stamp):
            return
        self.counts['in'] += 1
        try:
            frame = messages.image_to_frame(image)
            self._check_shape(frame)
        except Malformed as error:
            self.refuse(
                f'image_raw: {error}; frame refused, answered empty', f'image_raw {error.reason}')
            self._publish([], image.header)
            return
        self._memory, declared = self._tuned.step(self._memory, frame, self._rng)
        self._publish(declared.estimates(), image.header)

    def _check_shape(self, frame: np.ndarray) -> None:
        if self._shape is None:
            self._start((frame.shape[0], frame.shape[1]))
        elif frame.shape != self._shape:
            raise Malformed(
                'change of size', f'frame of {frame.shape[1]} x {frame.shape[0]} cells after '
                f'frames of {self._shape[1]} x {self._shape[0]}')

    def _publish(self, estimates: list, header: Header) -> None:
        for item in estimates:
            if item.id:
                self._odometry.publish(messages.estimate_to_odometry(item, header))
        self._array.publish(messages.estimates_to_array(
            estimates, header, self.detector.sensor.cell_size_m))
        self.counts['out'] += 1


def entry_point(detector: str) -> Callable[[list[str] | None], None]:
    """Return the main() of the node of one registered detector."""
    def main(args: list[str] | None = None) -> None:
        run(lambda: DetectorNode(detector), args)
    return main


def __getattr__(name: str) -> Callable[[list[str] | None], None]:
    """Give every registered detector its entry point, as ``ros2 run`` asks for it."""
    try:
        detector_class(name)
    except ValueError:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}') from None
    return entry_point(name)


if __name__ == '__main__':
    import sys
    entry_point(sys.argv.pop(1))(None)
