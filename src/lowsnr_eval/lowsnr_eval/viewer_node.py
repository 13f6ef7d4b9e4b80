# SPDX-License-Identifier: Apache-2.0
"""The viewer node: frames with truth, detections and tracks drawn in, for people."""

from __future__ import annotations

from functools import partial
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.records import AlarmRate
from lowsnr_common.core.records import Estimate
from lowsnr_common.ros import messages
from lowsnr_common.ros import run_records
from lowsnr_common.ros.bringup_line import LAST_FRAME
from lowsnr_common.ros.bringup_line import LIVE_PAGE
from lowsnr_common.ros.frame_maps import FrameMaps
from lowsnr_common.ros.images import image_to_array
from lowsnr_common.ros.inputs import Input
from lowsnr_common.ros.managed_node import ManagedNode
from lowsnr_common.ros.node_main import run
from lowsnr_common.ros.parameters import declare
from lowsnr_common.ros.qos import any_reliability
from lowsnr_common.ros.qos import reliable
from lowsnr_common.settings.node_settings import FrameSettings
from lowsnr_common.settings.node_settings import ViewSettings
from lowsnr_eval.live.live_page import frame_text
from lowsnr_eval.live.live_page import live_page
from lowsnr_eval.live.live_page import open_page
from lowsnr_eval.live.live_page import statistic_picture
from lowsnr_eval.live.live_server import LiveServer
from lowsnr_eval.report.overlay import draw
from lowsnr_eval.report.overlay import Scene
from lowsnr_eval.report.overlay import Trails
from lowsnr_eval.report.palette import grey_range
from lowsnr_eval.report.palette import to_greys
from lowsnr_eval.ros.view_messages import picture_to_image
from lowsnr_eval.ros.view_messages import scene_to_markers
from lowsnr_eval.scoring.frame_join import Arrival
from lowsnr_eval.scoring.frame_join import FrameJoin
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from std_msgs.msg import String
from vision_msgs.msg import Detection2DArray
from visualization_msgs.msg import MarkerArray

FRAMES, TRUTH, DETECTIONS, TRACKS = 'image_raw', 'ground_truth', 'detections', 'tracks'
# Frames that wait for a slow reader, and for a slow chain.
_DEPTH = 16
# A frame that is not answered within this time is shown without the answer.
_PATIENCE_S = 1.0


class ViewerNode(ManagedNode):
    """
    Show each frame that detector and tracker answered: ``overlay``, ``markers``, a live page.

    No other node waits for it once the run has begun, and it drops the frames for which it is
    too slow.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('viewer', **kwargs)
        self.view = declare(self, ViewSettings)
        self.frames = declare(self, FrameSettings)
        self._live: LiveServer | None = None
        self._rate = AlarmRate()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Create publishers and subscriptions, and serve the live page."""
        self._serve()
        self._join = FrameJoin((FRAMES, DETECTIONS, TRACKS), FRAMES, lag=self.view.lag)
        self.bringup.hear(LAST_FRAME, Clock, lambda _: self._join.end_frames())
        self.bringup.hear(run_records.ALARM_RATE, DiagnosticArray, self._on_alarm_rate)
        self._trails = Trails(self.view.trail_frames)
        self._truth: dict[int, list[Estimate]] = {}
        self._greys: dict[int, tuple[Header, np.ndarray, tuple[float, float]]] = {}
        self._overlay = self.create_publisher(Image, 'overlay', reliable(_DEPTH))
        self._markers = self.create_publisher(MarkerArray, 'markers', reliable(_DEPTH))
        self.outputs = {self._overlay: 0, self._markers: 0}
        depth = reliable(self.settings.queue_depth)
        # Of several waiting messages the node takes those of the topics named first.
        self.listen(  # recorded frames may lack truth
            Detection2DArray, TRUTH, self._on_truth, depth, needed=False)
        self.listen(Detection2DArray, DETECTIONS, partial(self._on_array, DETECTIONS), depth,
                    first=self._listen_to_statistic())
        self.listen(Image, FRAMES, self._on_frame, any_reliability(_DEPTH))
        states = self.listen(
            Odometry, f'{TRACKS}/odometry', self._on_track, depth, steady=False)
        self.listen(
            Detection2DArray, TRACKS, partial(self._on_array, TRACKS), depth, first=states)
        self.create_timer(_PATIENCE_S, self._on_timer)
        return TransitionCallbackReturn.SUCCESS

    def _listen_to_statistic(self) -> Input | None:
        """Subscribe to the statistic for the live page, if the detector publishes it."""
        self._statistics: dict[int, dict[str, Any]] = {}
        if not self.view.statistic_map:
            return None
        maps = FrameMaps(self, self.frames.conditioned, self._on_statistic)
        return self.listen(Image, 'statistic', maps.take, reliable(_DEPTH), first=maps.input)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave the browsers too."""
        self._leave_browsers()
        return super().on_cleanup(state)

    def destroy_node(self) -> None:
        """Leave the browsers, however the node ends."""
        self._leave_browsers()
        super().destroy_node()

    def _serve(self) -> None:
        """Serve the live page; open it in the user's browser unless that was done before."""
        if self.view.page:
            self._live = LiveServer(live_page(self.view), self.view.page_port)
            self.get_logger().info(f'live page: {self._live.address}')
            self.bringup.tell(LIVE_PAGE, String(data=self._live.address))
            if self.view.browser and not self._began:
                open_page(self._live.address)

    def _leave_browsers(self) -> None:
        if self._live:
            self._live.close()
            self._live = None

    def _on_alarm_rate(self, message: DiagnosticArray) -> None:
        """Keep the false-alarm rate of the detector of this chain."""
        path, rate = run_records.rate_from_message(message)
        if path.rpartition('/')[0] == self.get_namespace().rstrip('/'):
            self._rate = rate

    def _on_frame(self, image: Image) -> None:
        if not self.active or not self.is_new(FRAMES, image.header.stamp):
            return
        self.counts['in'] += 1
        cells = image_to_array(image)
        limits = grey_range(cells)
        stamp = messages.stamp_key(image.header.stamp)
        if self._join.add_array(FRAMES, stamp, [], time.monotonic()) is Arrival.USED:
            self._keep(self._greys, stamp, (image.header, to_greys(cells, limits), limits))
            self._show()

    def _keep(self, kept: dict[int, Any], stamp: int, item: Any) -> None:
        """Keep an item of a frame until the frame is shown."""
        kept[stamp] = item
        if len(kept) > _DEPTH + self.view.lag:
            del kept[min(kept)]

    def _on_statistic(self, image: Image, where: FrameMap | None) -> None:
        if self._live and self._live.watched:
            self._keep(self._statistics, messages.stamp_key(image.header.stamp),
                       statistic_picture(image_to_array(image), where))

    def _on_truth(self, message: Detection2DArray) -> None:
        self._keep(self._truth, messages.stamp_key(message.header.stamp),
                   messages.array_to_sound_estimates(message, self.view.sensor.cell_size_m))

    def _on_array(self, topic: str, message: Detection2DArray) -> None:
        entries = messages.array_to_sound_estimates(message, self.view.sensor.cell_size_m)
        if topic != TRACKS:  # their odometry is not subscribed to
            entries = [Estimate(item.state, item.cov, item.score) for item in entries]
        stamp = messages.stamp_key(message.header.stamp)
        self._join.add_array(topic, stamp, entries, time.monotonic())
        self._show()

    def _on_track(self, message: Odometry) -> None:
        stamp = messages.stamp_key(message.header.stamp)
        self._join.add_state(TRACKS, stamp, messages.odometry_to_estimate(message, 0.0))
        self._show()

    def _on_timer(self) -> None:
        self._show(time.monotonic() - _PATIENCE_S)

    def _show(self, older_than_s: float = -float('inf')) -> None:
        """Publish the frames that are complete, or have waited since ``older_than_s`` [s]."""
        for frame in self._join.take(older_than_s):
            tracks, truth = frame.answer(TRACKS) or [], self._truth.pop(frame.stamp, None)
            scene = Scene(
                truth or [], frame.answer(DETECTIONS) or [], tracks,
                self._trails.add(tracks))
            if frame.stamp in self._greys:
                header, greys, limits = self._greys.pop(frame.stamp)
                self._publish(scene, header, greys)
                self._send(
                    frame.stamp, (truth, *map(frame.answer, (DETECTIONS, TRACKS))), greys, limits)

    def _send(
        self, stamp: int, answers: tuple[list[Estimate] | None, ...], greys: np.ndarray,
        limits: tuple[float, float],
    ) -> None:
        """Send a frame with its stamp [ns] to the browsers, if there are any."""
        if self._live and self._live.watched:
            self._live.publish(frame_text(
                stamp / 1e9, greys, limits, answers, self._rate, self.view.sensor.cell_size_m,
                self._statistics.pop(stamp, None)))

    def _publish(self, scene: Scene, header: Header, greys: np.ndarray) -> None:
        """Publish where there is a reader; drawing for none takes time from the other nodes."""
        if self._overlay.get_subscription_count():
            self._overlay.publish(picture_to_image(draw(greys, scene, self.view), header))
        if self._markers.get_subscription_count():
            self._markers.publish(scene_to_markers(
                scene, (greys.shape[0], greys.shape[1]), header, self.view))
        self.counts['out'] += 1


def main(args: list[str] | None = None) -> None:
    """Entry point of ``ros2 run lowsnr_eval viewer_node``."""
    run(ViewerNode, args)


if __name__ == '__main__':
    main()
