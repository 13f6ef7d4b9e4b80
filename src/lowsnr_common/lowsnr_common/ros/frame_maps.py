# SPDX-License-Identifier: Apache-2.0
"""
The map of a conditioned frame as messages, and joined with the messages about its frame.

``camera_info`` beside a conditioned image holds it: K projects the scene to the image of the
camera, whose ``frame_id`` it has, P to the conditioned image.  The scene is a plane in pixels,
with z = 1.  ``camera_motion`` states the motion alone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import TransformStamped
from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.records import Malformed
from lowsnr_common.core.timeline import in_seconds
from lowsnr_common.ros.inputs import Input
from lowsnr_common.ros.messages import stamp_key
from lowsnr_common.ros.qos import reliable
import numpy as np
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

NO_MAP = 'no map'
SCENE = 'scene'
# Messages that wait for the map of their frame.
_MOST_WAITING = 32
_MOST_BINNED, _FARTHEST = 16, 1e9


def map_to_info(where: FrameMap, header: Header) -> CameraInfo:
    """Return the map of the image of a header as its projections."""
    scale = 1.0 / where.binning
    shift = [-start - (where.binning - 1) / 2.0 * scale for start in where.origin]
    x, y = where.to_image
    return CameraInfo(
        header=header, width=where.size[0], height=where.size[1],
        binning_x=where.binning, binning_y=where.binning,
        k=np.array([1.0, 0.0, x, 0.0, 1.0, y, 0.0, 0.0, 1.0]),
        r=np.eye(3).ravel(),
        p=np.array([scale, 0.0, shift[0], 0.0, 0.0, scale, shift[1], 0.0, 0.0, 0.0, 1.0, 0.0]))


def info_to_map(info: CameraInfo) -> FrameMap:
    """
    Return the map that projections state.

    Raises
    ------
    Malformed
        If they are not those of a conditioned frame; the reason is ``no map of a frame``.

    """
    binning, x, y = int(info.binning_x), float(info.k[2]), float(info.k[5])
    shift = float(info.p[2]), float(info.p[6])
    sound = (
        info.width and info.height and 1 <= binning <= _MOST_BINNED
        and all(abs(value) <= _FARTHEST for value in (x, y, *shift)))
    if not sound:
        raise Malformed(
            'no map of a frame', f'the image is {info.width} x {info.height}, moved by '
            f'({x:g}, {y:g}), its cells by {shift}, binned {binning}')
    column, row = (round(-part - (binning - 1) / 2.0 / binning) for part in shift)
    return FrameMap(
        info.header.frame_id, (info.width, info.height), binning, (column, row), (x, y))


def map_to_motion(where: FrameMap, header: Header) -> TransformStamped:
    """Return the motion from the scene to the image of a header [pixels]."""
    motion = TransformStamped(header=header, child_frame_id=f'{header.frame_id}_{SCENE}')
    motion.transform.translation.x, motion.transform.translation.y = where.to_image
    motion.transform.rotation.w = 1.0
    return motion


class FrameMaps:
    """
    Joins the messages of a topic with the maps of their frames, by stamp.

    A message waits for the map of its frame.  It is dropped, and that is reported, when a later
    message has its map, because maps arrive in order, and when too many wait.

    Parameters
    ----------
    node
        The :class:`lowsnr_common.ros.managed_node.ManagedNode` that takes the messages.
    conditioned
        Whether there are maps; without, each message is answered at once.
    answer
        Called with each message and its map, None if there are none.
    on_map
        Called with the stamp [ns] of each map and the map as it arrives.

    """

    def __init__(
        self, node: Any, conditioned: bool, answer: Callable[[Any, FrameMap | None], None],
        on_map: Callable[[int, FrameMap], None] = lambda stamp, where: None,
    ) -> None:
        self._node, self._conditioned, self._answer = node, conditioned, answer
        self._on_new_map = on_map
        self._depth = node.settings.queue_depth
        self._maps: dict[int, FrameMap] = {}
        self._waiting: deque[Any] = deque()
        self.input: Input | None = None
        if conditioned:
            self.input = node.listen(
                CameraInfo, 'camera_info', self._on_map, reliable(self._depth))

    def take(self, message: Any) -> None:
        """Answer a message, or let it wait for its map."""
        if not self._conditioned:
            self._answer(message, None)
            return
        self._waiting.append(message)
        self._match()
        if len(self._waiting) > _MOST_WAITING:
            self._drop()

    def _on_map(self, info: CameraInfo) -> None:
        where = info_to_map(info)
        if self._node.active:
            stamp = stamp_key(info.header.stamp)
            if self._maps.setdefault(stamp, where) is where:
                self._on_new_map(stamp, where)
            # A message comes after its map, by all that waits in a node between.
            if len(self._maps) > 2 * self._depth + _MOST_WAITING:
                del self._maps[next(iter(self._maps))]
            self._match()

    def _match(self) -> None:
        """Answer the messages that have their maps, and drop those before."""
        for message in list(self._waiting):
            where = self._maps.pop(stamp_key(message.header.stamp), None)
            if where is not None:
                while self._waiting[0] is not message:
                    self._drop()
                self._waiting.popleft()
                self._answer(message, where)

    def _drop(self) -> None:
        stamp = stamp_key(self._waiting.popleft().header.stamp)
        self._node.reject(
            'camera_info', NO_MAP, f'no map of the frame of {in_seconds(stamp)} s; frame dropped')
