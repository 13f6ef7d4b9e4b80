# SPDX-License-Identifier: Apache-2.0
"""The detector node: any registered detector between ``image_raw`` and ``detections``."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import asdict
from dataclasses import dataclass
import time
from typing import Any

from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.records import AlarmRate
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Malformed
from lowsnr_common.core.streams import stream
from lowsnr_common.ros import messages
from lowsnr_common.ros import run_records
from lowsnr_common.ros.bringup_line import LAST_FRAME
from lowsnr_common.ros.frame_maps import FrameMaps
from lowsnr_common.ros.managed_node import ManagedNode
from lowsnr_common.ros.node_main import run
from lowsnr_common.ros.parameters import declare
from lowsnr_common.ros.qos import any_reliability
from lowsnr_common.ros.qos import frame_depth
from lowsnr_common.ros.qos import reliable
from lowsnr_common.settings.flat_values import changed
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_common.settings.node_settings import FrameSettings
from lowsnr_detect.grid.fixed_lag import lag_of
from lowsnr_detect.node.live_detector import in_image
from lowsnr_detect.node.live_detector import LiveDetector
from lowsnr_detect.node.live_settings import acts
from lowsnr_detect.node.live_settings import check_effect
from lowsnr_detect.node.warm_up import warm_up
from lowsnr_detect.parts.detector import Declarations
from lowsnr_detect.parts.registry import detector_class
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.lifecycle import LifecyclePublisher
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn
from rosgraph_msgs.msg import Clock
import scipy.ndimage  # noqa: F401  (here, so that no frame waits for it)
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray


@dataclass
class OpenFrame:
    """A frame without an answer yet: its header and map, when it came, whether it is rejected."""

    header: Header
    where: FrameMap | None
    arrived_s: float
    rejected: bool = False


class DetectorNode(ManagedNode):
    """
    Answer each frame on ``image_raw`` with one array on ``detections``, empty for none.

    An answer has the header of the frame that it is about.  With a lag the answer about a frame
    is published when so many frames more have arrived, or when bring-up says that none will.
    """

    offers = ('detections',)

    def __init__(self, detector: str, **kwargs: Any) -> None:
        super().__init__(f'{detector}_detector', **kwargs)
        self.name = detector
        self.live = (
            declare(self, detector_class(detector), live=True),
            declare(self, DetectionSettings, live=True))
        self._work: LiveDetector | None = None
        self.frames = declare(self, FrameSettings)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Create publishers and subscription; calibrate where the frame size is known."""
        operating = self.live[1]
        warm_up(*self.live)
        shape = (operating.rows, operating.cols)
        self._work = self._start(shape) if all(shape) else None
        self._rng = stream(self.settings.seed, 'detector')
        depth = self.settings.queue_depth
        self._array = self.create_publisher(
            Detection2DArray, 'detections', reliable(depth))
        self._odometry = self.create_publisher(Odometry, 'detections/odometry', reliable(depth))
        self.outputs = {
            self._array: self.settings.consumers, self._odometry: bool(self.settings.consumers)}
        self._statistic = self._open_map(shape) if operating.statistic_map else None
        self._maps = FrameMaps(self, self.frames.conditioned, self._answer)
        self._map: FrameMap | None = None
        self._open: deque[OpenFrame] = deque()
        self._newest_ns = -1
        self._last_ns: int | None = None
        self.bringup.hear(LAST_FRAME, Clock, self._on_last_frame)
        self.listen(
            Image, 'image_raw', self._on_frame, any_reliability(frame_depth(depth, *shape)),
            first=self._maps.input)
        return TransitionCallbackReturn.SUCCESS

    def _open_map(self, shape: tuple[int, int]) -> LifecyclePublisher:
        """Create the publisher of the statistic, which all consumers but the tracker read."""
        depth = frame_depth(self.settings.queue_depth, *shape)
        made = self.create_publisher(Image, 'statistic', reliable(depth))
        self.outputs[made] = self.frame_readers(max(self.settings.consumers - 1, 0))
        return made

    def _start(self, shape: tuple[int, int]) -> LiveDetector:
        return LiveDetector(self.name, self.live, shape, self.get_logger().info)

    def complete(self, values: dict[str, Any]) -> dict[str, Any]:
        """Reject what cannot be put in force; 'manual' begins with the thresholds in force."""
        detector, operating = (changed(one, values) for one in self.live)
        check_effect(values, (detector, operating))
        if self._work is None:
            return values
        self._work.check((detector, operating))
        by_hand = operating.operating_point == 'manual' != self.live[1].operating_point
        return self._work.thresholds() | values if by_hand else values

    def on_set(self) -> None:
        """Put the new settings in force from the next frame on."""
        if self._work:
            self._give(self._work.change(self.live, self.counts['in'] + 1))

    def facts(self) -> dict[str, str]:
        """Return the lag, and the false-alarm probability asked for and measured, if any."""
        lag = lag_of(self.live[0])
        found = {'lag [frames]': str(lag)} if lag else {}
        return found | {f'false_alarm_prob {name}': f'{share:.4g}'
                        for name, share in asdict(self._alarm_rate()).items()
                        if share is not None}

    def report(self) -> None:
        """Publish counts, times and faults; tell bring-up the false-alarm rate."""
        super().report()
        self.bringup.tell(run_records.ALARM_RATE, run_records.rate_to_message(
            self.get_fully_qualified_name(), self._alarm_rate()))

    def _alarm_rate(self) -> AlarmRate:
        operating = self.live[1]
        return AlarmRate(
            operating.false_alarm_prob if acts('false_alarm_prob', operating) else None,
            self._work.measured() if self._work else None)

    def _on_frame(self, image: Image) -> None:
        if not self.active or not self.is_new('image_raw', image.header.stamp):
            return
        self.counts['in'] += 1
        self._maps.take(image)

    def _answer(self, image: Image, where: FrameMap | None) -> None:
        """Answer a frame; one of a conditioner in pixels of the image that its map names."""
        header = image.header
        if where is not None:
            header = Header(stamp=header.stamp, frame_id=where.frame_id)
        self._open.append(OpenFrame(header, where, time.perf_counter()))
        self._take(image, where)
        self._newest_ns = messages.stamp_key(header.stamp)
        self._flush_after_last()

    def _take(self, image: Image, where: FrameMap | None) -> None:
        """Give a frame to the detector, and publish what it answers."""
        try:
            frame = messages.image_to_frame(image)
            work = self._work_for(frame)
        except Malformed as error:
            self.reject(
                'image_raw', error.reason, f'{error}; frame rejected, empty array published')
            self._open[-1].rejected = True
            self._give([])
            return
        if where is not None and any(by := where.moved_since(self._map)):
            self._give(work.move(by))
        self._map = where
        self._give(work.step(frame, self._rng))
        if self._statistic and work.map is not None:
            self._statistic.publish(messages.frame_to_image(work.map, image.header))

    def _on_last_frame(self, last: Clock) -> None:
        """Answer the frames that wait for later ones once the last one of the run is here."""
        self._last_ns = messages.stamp_key(last.clock)
        self._flush_after_last()

    def _flush_after_last(self) -> None:
        if self._work and self._last_ns is not None and self._newest_ns >= self._last_ns:
            self._give(self._work.flush())

    def _give(self, answers: list[Declarations]) -> None:
        """Publish answers about the oldest open frames, and empty arrays for rejected ones."""
        self._pass_rejected()
        for declared in answers:
            about = self._open.popleft()
            found = in_image(
                declared, about.where, self._map, self.live[0].sensor.cell_size_m)
            if lag_of(self.live[0]):
                self.health.spent('frame to answer', time.perf_counter() - about.arrived_s)
            self._publish(found, about.header)
            self._pass_rejected()

    def _pass_rejected(self) -> None:
        while self._open and self._open[0].rejected:
            self._publish([], self._open.popleft().header)

    def _work_for(self, frame: np.ndarray) -> LiveDetector:
        """Return the detector, which the first frame starts; Malformed for another size."""
        rows, cols = frame.shape
        if self._work is None:
            self._work = self._start((rows, cols))
        elif self._work.shape != frame.shape:
            raise Malformed(
                'change of size', f'frame of {cols} x {rows} cells after frames of '
                f'{self._work.shape[1]} x {self._work.shape[0]}')
        return self._work

    def _publish(self, estimates: list[Estimate], header: Header) -> None:
        for item in estimates:
            if item.id:
                self._odometry.publish(messages.estimate_to_odometry(item, header))
        array = messages.estimates_to_array(estimates, header, self.live[0].sensor.cell_size_m)
        self._array.publish(array)
        self.hand_over('detections', array)
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
