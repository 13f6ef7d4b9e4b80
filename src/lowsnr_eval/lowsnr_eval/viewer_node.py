"""The viewer node: frames with truth, detections and tracks drawn in, for people."""

from __future__ import annotations

from functools import partial
import time
from typing import Any

from lowsnr_common.core.records import Estimate
from lowsnr_common.ros import messages
from lowsnr_common.ros.images import image_to_array
from lowsnr_common.ros.managed_node import ManagedNode
from lowsnr_common.ros.node_main import run
from lowsnr_common.ros.parameters import declare
from lowsnr_common.ros.qos import any_reliability
from lowsnr_common.ros.qos import reliable
from lowsnr_common.settings.node_settings import ViewSettings
from lowsnr_eval.report.overlay import draw
from lowsnr_eval.report.overlay import Scene
from lowsnr_eval.report.overlay import Trails
from lowsnr_eval.report.palette import stretch
from lowsnr_eval.ros.view_messages import picture_to_image
from lowsnr_eval.ros.view_messages import scene_to_markers
from lowsnr_eval.scoring.frame_join import Arrival
from lowsnr_eval.scoring.frame_join import FrameJoin
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray
from visualization_msgs.msg import MarkerArray

FRAMES, TRUTH, DETECTIONS, TRACKS = 'image_raw', 'ground_truth', 'detections', 'tracks'
# Frames that wait for a slow reader, and for a slow chain.
_DEPTH = 16
# A frame that is not answered within this time is shown without the answer.
_PATIENCE_S = 1.0


class ViewerNode(ManagedNode):
    """
    Publish ``overlay`` and ``markers`` for each frame that detector and tracker answered.

    No other node waits for it once the run has begun, and it drops the frames for which it is
    too slow.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('viewer', **kwargs)
        self.view = declare(self, ViewSettings)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Create publishers and subscriptions."""
        self._join = FrameJoin((FRAMES, DETECTIONS, TRACKS), FRAMES)
        self._trails = Trails(self.view.trail_frames)
        self._greys: dict[int, tuple[Header, np.ndarray]] = {}
        self._overlay = self.create_publisher(Image, 'overlay', reliable(_DEPTH))
        self._markers = self.create_publisher(MarkerArray, 'markers', reliable(_DEPTH))
        self.outputs = {self._overlay: 0, self._markers: 0}
        depth = reliable(self.settings.queue_depth)
        # Of several waiting messages the node takes those of the topics named first.
        self.listen(  # recorded frames may lack truth
            Detection2DArray, TRUTH, partial(self._on_array, TRUTH), depth, needed=False)
        self.listen(Detection2DArray, DETECTIONS, partial(self._on_array, DETECTIONS), depth)
        self.listen(Image, FRAMES, self._on_frame, any_reliability(_DEPTH))
        states = self.listen(
            Odometry, f'{TRACKS}/odometry', self._on_track, depth, steady=False)
        self.listen(
            Detection2DArray, TRACKS, partial(self._on_array, TRACKS), depth, first=states)
        self.create_timer(_PATIENCE_S, self._on_timer)
        return TransitionCallbackReturn.SUCCESS

    def _on_frame(self, image: Image) -> None:
        if not self.active or not self.is_new(FRAMES, image.header.stamp):
            return
        self.counts['in'] += 1
        greys = stretch(image_to_array(image))
        stamp = messages.stamp_key(image.header.stamp)
        if self._join.add_array(FRAMES, stamp, [], time.monotonic()) is Arrival.USED:
            self._greys[stamp] = image.header, greys
            if len(self._greys) > _DEPTH:
                del self._greys[min(self._greys)]
            self._show()

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
            tracks = frame.answer(TRACKS) or []
            scene = Scene(
                frame.answer(TRUTH) or [], frame.answer(DETECTIONS) or [], tracks,
                self._trails.add(tracks))
            if frame.stamp in self._greys:
                self._publish(scene, *self._greys.pop(frame.stamp))

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
