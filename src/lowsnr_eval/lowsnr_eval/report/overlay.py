# SPDX-License-Identifier: Apache-2.0
"""A frame with truth, detections and tracks drawn on it."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_common.core.records import Estimate
from lowsnr_common.settings.node_settings import ViewSettings
from lowsnr_eval.report.palette import DETECTION
from lowsnr_eval.report.palette import rgb
from lowsnr_eval.report.palette import TRACK
from lowsnr_eval.report.palette import TRUTH
import numpy as np

_BLACK = (0, 0, 0)
_CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
_AROUND = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
_CIRCLE = np.stack([np.cos(_AROUND), np.sin(_AROUND)], axis=-1)
# OpenCV takes positions in 1/16 of a pixel; points farther away than this are not visible.
_SHIFT, _FARTHEST = 4, 2.0**20
_LINE, _EDGE = 2, 4


@dataclass(frozen=True)
class Scene:
    """Objects, declarations and tracks of a frame; ``trails`` come from :meth:`Trails.add`."""

    truth: Sequence[Estimate] = ()
    detections: Sequence[Estimate] = ()
    tracks: Sequence[Estimate] = ()
    trails: Mapping[str, np.ndarray] | None = None


class Trails:
    """The positions of the tracks in the last ``frames`` frames."""

    def __init__(self, frames: int) -> None:
        self._frames = frames
        self._now = 0
        self._past: dict[str, deque[tuple[float, ...]]] = {}

    def add(self, tracks: Iterable[Estimate]) -> dict[str, np.ndarray]:
        """
        Add the tracks of a frame.

        Returns
        -------
        dict of (n, 4) ndarray
            By id, oldest first: age [frames], x and y [m], existence probability.

        """
        self._now += 1
        for track in tracks:
            self._past.setdefault(track.id, deque()).append(
                (self._now, *track.state[POS], track.score))
        for name, past in list(self._past.items()):
            while past and past[0][0] <= self._now - self._frames:
                past.popleft()
            if not past:
                del self._past[name]
        return {name: np.array(past) * (-1.0, 1.0, 1.0, 1.0) + (self._now, 0.0, 0.0, 0.0)
                for name, past in self._past.items()}


def ellipse(track: Estimate, sigmas: float) -> np.ndarray:
    """Return points of the ellipse of a track's position, (48, 2) [m]; NaN if unknown."""
    cov = track.cov[np.ix_(POS, POS)]
    if not np.isfinite(cov).all():
        return np.full_like(_CIRCLE, np.nan)
    values, vectors = np.linalg.eigh(cov)
    axes = vectors * (sigmas * np.sqrt(np.maximum(values, 0.0)))
    points: np.ndarray = track.state[POS] + _CIRCLE @ axes.T
    return points


def zoom_of(shape: tuple[int, int], side: int) -> int:
    """Return the side of a cell in an overlay of at least ``side`` pixels [pixels]."""
    return max(1, -(-side // max(shape)))


def draw(greys: np.ndarray, scene: Scene, settings: ViewSettings) -> np.ndarray:
    """
    Return an overlay.

    Truth is a circle, a detection a square, a track a cross with its id, its trail, its ellipse
    and a line to its predicted position in the next frame.

    Parameters
    ----------
    greys
        Frame in greys, (rows, cols) of uint8, see :func:`lowsnr_eval.report.palette.stretch`.
    scene
        The marks.
    settings
        Size of the overlay, sensor and ellipses.

    Returns
    -------
    (rows * zoom, cols * zoom, 3) ndarray of uint8
        Red, green and blue; cells are squares of one colour.

    """
    zoom = zoom_of((greys.shape[0], greys.shape[1]), settings.side)
    picture = np.repeat(np.repeat(greys, zoom, axis=0), zoom, axis=1)
    pen = _Pen(np.repeat(picture[:, :, None], 3, axis=2), zoom, settings.sensor.cell_size_m)
    for item in scene.truth:
        pen.closed(item.state[POS], 1.5 * pen.reach * _CIRCLE, TRUTH)
    for item in scene.detections:
        pen.closed(item.state[POS], pen.reach * _CORNERS, DETECTION)
    for trail in (scene.trails or {}).values():
        pen.line(trail[:, 1:3], TRACK)
    for item in scene.tracks:
        pen.track(item, settings)
    return pen.picture


class _Pen:
    """Draws lines at positions in metres, each on a dark edge so that any grey shows it."""

    def __init__(self, picture: np.ndarray, zoom: int, cell_size_m: float) -> None:
        self.picture = picture
        self._zoom = zoom
        self._cell_size_m = cell_size_m
        self.reach = max(7.0, 0.6 * zoom)  # of a mark [pixels]

    def line(self, points_m: np.ndarray, colour: str) -> None:
        """Draw a line through (n, 2) points."""
        self._lines([self._pixels(points_m)], False, colour)

    def closed(self, centre_m: np.ndarray, shape: np.ndarray, colour: str) -> None:
        """Draw a closed line of (n, 2) corners [pixels] around a position."""
        self._lines([self._pixels(centre_m) + shape], True, colour)

    def track(self, item: Estimate, settings: ViewSettings) -> None:
        """Draw a track without its trail."""
        place = self._pixels(item.state[POS])
        next_m = item.state[POS] + settings.sensor.frame_period_s * item.state[VEL]
        self._lines([self._pixels(ellipse(item, settings.ellipse_sigmas))], True, TRACK)
        self._lines([np.array([place, self._pixels(next_m)])], False, TRACK)
        half = 0.7 * self.reach * _CORNERS
        self._lines([place + half[::2], place + half[1::2]], False, TRACK)
        if np.isfinite(place).all():
            x, y = np.clip(place + (self.reach, -self.reach), -_FARTHEST, _FARTHEST).astype(int)
            for ink, width in ((_BLACK, _EDGE), (rgb(TRACK), _LINE)):
                cv2.putText(self.picture, item.id, (int(x), int(y)), cv2.FONT_HERSHEY_SIMPLEX,
                            0.6, ink, width, cv2.LINE_AA)

    def _pixels(self, positions_m: np.ndarray) -> np.ndarray:
        """Return positions in pixels; the centre of the first cell is at (zoom - 1) / 2."""
        return (positions_m / self._cell_size_m + 0.5) * self._zoom - 0.5

    def _lines(self, lines: Sequence[np.ndarray], closed: bool, colour: str) -> None:
        fixed = [
            np.round(np.clip(line, -_FARTHEST, _FARTHEST) * 2**_SHIFT).astype(np.int32)
            for line in lines if np.isfinite(line).all()]
        for ink, width in ((_BLACK, _EDGE), (rgb(colour), _LINE)):
            cv2.polylines(self.picture, fixed, closed, ink, width, cv2.LINE_AA, _SHIFT)
