# SPDX-License-Identifier: Apache-2.0
"""The overlay and the scene of a viewer, as messages."""

from __future__ import annotations

import array
from collections.abc import Sequence

from geometry_msgs.msg import Point
from lowsnr_common.core.motion import POS
from lowsnr_common.core.records import Estimate
from lowsnr_common.settings.node_settings import ViewSettings
from lowsnr_eval.report.overlay import ellipse
from lowsnr_eval.report.overlay import Scene
from lowsnr_eval.report.palette import DETECTION
from lowsnr_eval.report.palette import rgb
from lowsnr_eval.report.palette import TRACK
from lowsnr_eval.report.palette import TRUTH
import numpy as np
from sensor_msgs.msg import Image
from std_msgs.msg import ColorRGBA
from std_msgs.msg import Header
from visualization_msgs.msg import Marker
from visualization_msgs.msg import MarkerArray

_GREY = '#808080'
# The plot of the existence probability: its height and its distance from the frame, in heights
# of the frame.
_PLOT, _GAP = 0.25, 0.08


def picture_to_image(picture: np.ndarray, header: Header) -> Image:
    """Return a (rows, cols, 3) picture as an rgb8 image."""
    rows, cols, _ = picture.shape
    data = array.array('B')
    data.frombytes(picture.tobytes())
    return Image(
        header=header, height=rows, width=cols, encoding='rgb8', step=3 * cols, data=data)


def scene_to_markers(
    scene: Scene, shape: tuple[int, int], header: Header, settings: ViewSettings,
) -> MarkerArray:
    """
    Return a scene as markers in metres, which replace all earlier ones.

    x and y are those of the frame, y down.  A plot below the frame shows the existence
    probability of the tracks over the last frames, the newest at the right.
    """
    cell, trails = settings.sensor.cell_size_m, scene.trails or {}
    make = _MarkerList(header)
    make.lines('frame', _GREY, 0.1 * cell, [
        _box(-0.5, -0.5, shape[1] - 0.5, shape[0] - 0.5, cell)])
    make.dots('truth', Marker.SPHERE_LIST, TRUTH, cell, _places(scene.truth))
    make.dots('detections', Marker.CUBE_LIST, DETECTION, 0.6 * cell, _places(scene.detections))
    make.lines('trails', TRACK, 0.15 * cell, [trail[:, 1:3] for trail in trails.values()])
    rings = [ellipse(track, settings.ellipse_sigmas) for track in scene.tracks]
    make.lines('ellipses', TRACK, 0.1 * cell, [np.vstack([ring, ring[:1]]) for ring in rings])
    for track in scene.tracks:
        make.text('ids', track.id, track.state[POS] + (cell, -cell), cell)
    left, bottom = -0.5, shape[0] * (1.0 + _GAP + _PLOT)
    height = shape[0] * _PLOT
    make.lines('existence', _GREY, 0.05 * cell, [
        _box(left, bottom - height, left + shape[1], bottom, cell)])
    across = shape[1] / max(1, settings.trail_frames - 1)
    make.lines('existence', TRACK, 0.15 * cell, [
        cell * np.stack([left + shape[1] - trail[:, 0] * across,
                         bottom - height * trail[:, 3]], axis=-1) for trail in trails.values()])
    return MarkerArray(markers=make.markers)


class _MarkerList:
    """The markers of one frame."""

    def __init__(self, header: Header) -> None:
        self._header = header
        self.markers = [Marker(header=header, action=Marker.DELETEALL)]

    def dots(self, name: str, kind: int, colour: str, size: float, places: np.ndarray) -> None:
        """Add one marker for all places (n, 2) [m], none where there is no place."""
        points = [Point(x=x, y=y) for x, y in places.tolist() if np.isfinite(x + y)]
        if points:
            marker = self._add(name, kind, colour)
            marker.points = points
            marker.scale.x = marker.scale.y = marker.scale.z = size

    def lines(self, name: str, colour: str, width: float, lines: Sequence[np.ndarray]) -> None:
        """Add one marker for all lines, each through (n, 2) points [m]."""
        whole = [line for line in lines if np.isfinite(line).all()]
        ends = [np.stack([line[:-1], line[1:]], axis=1).reshape(-1, 2) for line in whole]
        self.dots(name, Marker.LINE_LIST, colour, width, np.vstack([np.empty((0, 2)), *ends]))

    def text(self, name: str, text: str, place: np.ndarray, size: float) -> None:
        """Add a text at a place [m]."""
        if np.isfinite(place).all():
            marker = self._add(name, Marker.TEXT_VIEW_FACING, TRACK)
            marker.text, marker.scale.z = text, size
            marker.pose.position.x, marker.pose.position.y = place.tolist()

    def _add(self, name: str, kind: int, colour: str) -> Marker:
        red, green, blue = (value / 255.0 for value in rgb(colour))
        marker = Marker(
            header=self._header, ns=name, id=len(self.markers), type=kind, action=Marker.ADD,
            color=ColorRGBA(r=red, g=green, b=blue, a=1.0))
        marker.pose.orientation.w = 1.0
        self.markers.append(marker)
        return marker


def _places(items: Sequence[Estimate]) -> np.ndarray:
    return np.array([item.state[POS] for item in items]).reshape(-1, 2)


def _box(left: float, top: float, right: float, bottom: float, cell: float) -> np.ndarray:
    return cell * np.array(
        [(left, top), (right, top), (right, bottom), (left, bottom), (left, top)])
