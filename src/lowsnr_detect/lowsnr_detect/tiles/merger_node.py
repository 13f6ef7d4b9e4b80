# SPDX-License-Identifier: Apache-2.0
"""The merger of a divided detector, which publishes ``detections`` from what the tiles find."""

from __future__ import annotations

from functools import partial
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from lowsnr_common.core.records import AlarmRate
from lowsnr_common.core.timeline import in_seconds
from lowsnr_common.ros import messages
from lowsnr_common.ros import run_records
from lowsnr_common.ros.diagnostics import Fault
from lowsnr_common.ros.managed_node import ManagedNode
from lowsnr_common.ros.node_main import run
from lowsnr_common.ros.parameters import declare
from lowsnr_common.ros.qos import reliable
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_common.settings.node_settings import TileSettings
from lowsnr_detect.node.live_settings import acts
from lowsnr_detect.parts.registry import detector_class
from lowsnr_detect.tiles.exceedances import declared
from lowsnr_detect.tiles.ros.clouds import cloud_to_exceedances
from lowsnr_detect.tiles.tile import divisible
from lowsnr_detect.tiles.tile import tiles_of
from lowsnr_detect.tiles.tile_join import JoinedFrame
from lowsnr_detect.tiles.tile_join import TileJoin
from lowsnr_detect.tiles.tile_join import WITHOUT_TILE
from lowsnr_detect.tiles.tile_node import tile_topic
from nav_msgs.msg import Odometry
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn
from sensor_msgs.msg import PointCloud2
from vision_msgs.msg import Detection2DArray

_LOOK_EVERY_S = 0.05


class MergerNode(ManagedNode):
    """
    Answer each frame with one array on ``detections``, from the exceedances of all tiles.

    A frame waits for each tile for at most ``tile_within_s``.  Where one is missing, nothing is
    declared in its cells; such frames are counted and reported.
    """

    def __init__(self, detector: str, **kwargs: Any) -> None:
        super().__init__(f'{detector}_detector', **kwargs)
        self.operating, self.tiling = declare(self, DetectionSettings), declare(self, TileSettings)
        self.shape = self.operating.rows, self.operating.cols
        self.detector = divisible(declare(self, detector_class(detector)), self.operating)
        self.tiles = dict(enumerate(tiles_of(self.detector, self.shape, self.tiling), 1))
        self._tile_of = {f'{detector}_{number}': number for number in self.tiles}

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Create publishers and subscriptions."""
        depth = reliable(self.settings.queue_depth)
        self._join = TileJoin(len(self.tiles), self.tiling.tile_within_s)
        self._array = self.create_publisher(Detection2DArray, 'detections', depth)
        # Without a velocity nothing is published there; the readers are those of any detector.
        self._odometry = self.create_publisher(Odometry, 'detections/odometry', depth)
        self.outputs = {
            self._array: self.settings.consumers, self._odometry: bool(self.settings.consumers)}
        for number in self.tiles:
            heard = self.listen(
                PointCloud2, tile_topic(number), partial(self._on_exceedances, number), depth)
            # A merger that starts again does not wait for a tile, which may be away.
            heard.awaited = not self.settings.lives
        self.bringup.hear(run_records.RESTARTS, DiagnosticArray, self._on_restart)
        self.create_timer(_LOOK_EVERY_S, self._answer)
        return TransitionCallbackReturn.SUCCESS

    def facts(self) -> dict[str, str]:
        """Return the false-alarm probability asked for, if any."""
        asked = self._alarm_rate().asked
        return {} if asked is None else {'false_alarm_prob asked': f'{asked:.4g}'}

    def report(self) -> None:
        """Publish counts, times and faults; tell bring-up the false-alarm rate."""
        super().report()
        self.bringup.tell(run_records.ALARM_RATE, run_records.rate_to_message(
            self.get_fully_qualified_name(), self._alarm_rate()))

    def _alarm_rate(self) -> AlarmRate:
        return AlarmRate(self.operating.false_alarm_prob if acts(
            'false_alarm_prob', self.operating) else None)

    def _on_exceedances(self, number: int, cloud: PointCloud2) -> None:
        topic = tile_topic(number)
        if not self.active or not self.is_new(topic, cloud.header.stamp):
            return
        self.counts['in'] += 1
        found = cloud_to_exceedances(cloud, self.tiles[number], self.detector)
        stamp = messages.stamp_key(cloud.header.stamp)
        if not self._join.add(number, stamp, (cloud.header, found), time.monotonic()):
            self.reject(topic, 'late exceedances', f'the frame of {in_seconds(stamp)} s was '
                        'answered without them')
        self._answer()

    def _on_restart(self, message: DiagnosticArray) -> None:
        """Wait no more for what the node of a tile lost when it died."""
        space, _, name = run_records.NodeRestarted.from_message(message).node.rpartition('/')
        if space == self.get_namespace().rstrip('/') and name in self._tile_of:
            self._join.pass_by(self._tile_of[name])
            self._answer()

    def _answer(self) -> None:
        """Publish what is declared in the frames that wait for no tile any more."""
        for frame in self._join.take(time.monotonic()) if self.active else ():
            self._count_missing(frame)
            headers, parts = zip(*frame.parts.values(), strict=True)
            found = declared(self.detector, parts, self.shape)
            self._array.publish(messages.estimates_to_array(
                found.estimates(), headers[0], self.detector.sensor.cell_size_m))
            self.counts['out'] += 1

    def _count_missing(self, frame: JoinedFrame) -> None:
        missing = [number for number in self.tiles if number not in frame.parts]
        self.counts[WITHOUT_TILE] += bool(missing)
        for number in missing:
            self.counts[f'without {tile_topic(number)}'] += 1
            self.warn(Fault(tile_topic(number), WITHOUT_TILE, f'the frame of '
                            f'{in_seconds(frame.stamp)} s is answered without this tile'))


def main(detector: str) -> None:
    """Run the merger of a detector."""
    run(lambda: MergerNode(detector))


if __name__ == '__main__':
    main(sys.argv.pop(1))
