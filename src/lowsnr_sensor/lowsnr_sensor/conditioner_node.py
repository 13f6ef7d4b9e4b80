# SPDX-License-Identifier: Apache-2.0
"""The conditioner node: it turns the frames of a real camera into those detectors expect."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from geometry_msgs.msg import TransformStamped
from lowsnr_common.core.records import Malformed
from lowsnr_common.ros import messages
from lowsnr_common.ros.diagnostics import Fault
from lowsnr_common.ros.frame_maps import map_to_info
from lowsnr_common.ros.frame_maps import map_to_motion
from lowsnr_common.ros.images import image_to_array
from lowsnr_common.ros.images import LocalFrame
from lowsnr_common.ros.managed_node import ManagedNode
from lowsnr_common.ros.node_main import run
from lowsnr_common.ros.parameters import declare
from lowsnr_common.ros.qos import any_reliability
from lowsnr_common.ros.qos import frame_depth
from lowsnr_common.ros.qos import reliable
from lowsnr_common.settings.node_settings import CameraFrameSettings
from lowsnr_sensor.conditioning.conditioner import ConditioningSettings
from lowsnr_sensor.conditioning.state import Conditioned
from lowsnr_sensor.conditioning.state import ConditionerState
import numpy as np
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn
import scipy.fft  # noqa: F401  (here, so that the first frame does not wait for it)
import scipy.ndimage  # noqa: F401
import scipy.special  # noqa: F401
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import Image
from std_msgs.msg import Header

# Where the size of frames is not known, the queues are as deep as for frames of this size.
_ASSUMED_SHAPE = (1024, 1024)
_WARM_UP_SHAPE, _WARM_UP_FRAMES = (64, 64), 6
# From the scene of a node to that of the one after its restart: beyond what any camera turns.
_FAR_CELLS = 1_000_000
# The events of a conditioned frame that mean that it is ignored.
_WITHOUT_CONTENT = {
    'blank': 'most pixels have no value', 'saturated': 'most pixels have the largest value',
    'flat': 'the scene is not seen in it'}


class ConditionerNode(ManagedNode):
    """
    Publish each frame on ``image_raw`` conditioned on ``conditioned/image_raw``.

    Before it, the node publishes where its cells lie in the camera's frame, on
    ``conditioned/camera_info``, and how the camera moved, on ``camera_motion``.
    """

    offers = ('conditioned/camera_info', 'conditioned/image_raw')

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('conditioner', **kwargs)
        self.camera = declare(self, CameraFrameSettings)
        self.conditioning = declare(self, ConditioningSettings)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Create publishers and the subscription, and load the compiled loops."""
        preload()
        depth, detectors = self.settings.queue_depth, self.settings.consumers
        size = self.camera.rows, self.camera.cols
        shape = size if all(size) else _ASSUMED_SHAPE
        self._conditioner_state: ConditionerState | None = None
        self._motion = self.create_publisher(TransformStamped, 'camera_motion', reliable(depth))
        self._info = self.create_publisher(
            CameraInfo, 'conditioned/camera_info', reliable(depth))
        self._image = self.create_publisher(
            Image, 'conditioned/image_raw',
            reliable(frame_depth(depth, *self.conditioning.size(shape))))
        evaluators = int(detectors > 0)
        self.outputs = {  # each detector has a tracker
            self._motion: 0, self._info: 2 * detectors + evaluators,
            self._image: self.frame_readers(detectors + evaluators)}
        self.listen(
            Image, 'image_raw', self._on_frame, any_reliability(frame_depth(depth, *shape)))
        return TransitionCallbackReturn.SUCCESS

    def _on_frame(self, image: Image) -> None:
        if not self.active or not self.is_new('image_raw', image.header.stamp):
            return
        self.counts['in'] += 1
        try:
            frame = image_to_array(image)
            before = self._conditioner_state or self._first_state(frame.shape)
            self._conditioner_state, output = self.conditioning.step(before, frame)
        except Malformed as error:
            if self._conditioner_state is None:
                self.reject('image_raw', error.reason, f'{error}; frame rejected')
                return
            self.reject(
                'image_raw', error.reason, f'{error}; frame rejected, published as zeros')
            output = self.conditioning.unobserved(self._conditioner_state)
        self._name(output.event)
        self._publish(output, image.header, self._conditioner_state.shape)

    def _name(self, event: str) -> None:
        """Report what is unusual about a frame: that it has no content, or a cut."""
        what = f'frame {self.counts["in"]}'
        if event == 'cut':
            self.warn(Fault('image_raw', event, f'{what} shows another scene: the background, '
                            'what detectors remember and tracks start anew'))
        elif event in _WITHOUT_CONTENT:
            self.reject('image_raw', f'{event} frame', f'{what} is {event}: '
                        f'{_WITHOUT_CONTENT[event]}; frame ignored, published as zeros')

    def _first_state(self, shape: tuple[int, ...]) -> ConditionerState:
        """Return the state before the first frame: of a restarted node, in another scene."""
        start = self.conditioning.init((shape[0], shape[1]))
        return replace(start, origin=(self.settings.lives * _FAR_CELLS, 0))

    def _publish(self, output: Conditioned, header: Header, shape: tuple[int, int]) -> None:
        """Publish a conditioned frame after its map, so that nobody waits for that."""
        where = self.conditioning.frame_map(output, header.frame_id, shape)
        self._motion.publish(map_to_motion(where, header))
        info = map_to_info(where, header)
        self._info.publish(info)
        self.hand_over('conditioned/camera_info', info)
        own = Header(stamp=header.stamp, frame_id=f'{header.frame_id}_cells')
        if self._image.get_subscription_count():  # perhaps all readers are in this process
            self._image.publish(messages.frame_to_image(output.cells, own))
        self.hand_over('conditioned/image_raw', LocalFrame(own, output.cells))
        self.counts['out'] += 1


def preload() -> None:
    """Condition a few small frames of a moving camera, so that the compiled loops are ready."""
    conditioning = ConditioningSettings()
    rng = np.random.default_rng(0)
    scene = np.kron(rng.standard_normal((16, 20)), np.full((4, 4), 100.0))
    state = conditioning.init(_WARM_UP_SHAPE)
    for k in range(_WARM_UP_FRAMES):
        frame = scene[:_WARM_UP_SHAPE[0], k:k + _WARM_UP_SHAPE[1]]
        state, _ = conditioning.step(state, frame + rng.standard_normal(_WARM_UP_SHAPE))


def main(args: list[str] | None = None) -> None:
    """Entry point of ``ros2 run lowsnr_sensor conditioner_node``."""
    run(ConditionerNode, args)


if __name__ == '__main__':
    main()
