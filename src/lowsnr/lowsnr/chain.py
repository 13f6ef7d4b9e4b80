# SPDX-License-Identifier: Apache-2.0
"""One chain on the frames of one sequence: what the nodes of a graph do, without messages."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from collections.abc import Iterator
from dataclasses import replace
import logging
from typing import NamedTuple

from lowsnr.frames import camera_pixels
from lowsnr.frames import detector_frame
from lowsnr.plan import Chain
from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.frame_map import overlaps
from lowsnr_common.core.records import AlarmRate
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.streams import stream
from lowsnr_detect.calibration.empty_frames import Progress
from lowsnr_detect.node.live_detector import LiveDetector
from lowsnr_detect.node.live_settings import acts
from lowsnr_detect.parts.detector import Declarations
from lowsnr_sensor.conditioning.conditioner import ConditioningSettings
from lowsnr_sensor.conditioning.state import Conditioned
import numpy as np

LOG = logging.getLogger('lowsnr')
FRAME_ID = 'frames'


class OpenFrame(NamedTuple):
    """A frame without an answer yet: its index, and where its cells lie, if it has any."""

    number: int
    where: FrameMap | None


class DetectorRun:
    """
    A detector from frame to frame.

    Parameters
    ----------
    chain
        The chain that it is part of.
    progress
        Called with the share of a calibration that is done.

    """

    def __init__(self, chain: Chain, progress: Progress) -> None:
        self._chain = chain
        self._work = LiveDetector(
            chain.name, (chain.detector, chain.operating), chain.shape, LOG.info, progress)
        self._rng = stream(chain.seed, 'detector')
        self._map: FrameMap | None = None
        self._open: deque[OpenFrame] = deque()

    def step(
        self, number: int, cells: np.ndarray, where: FrameMap | None,
    ) -> Iterator[tuple[OpenFrame, list[Estimate]]]:
        """
        Take the next frame; yield answers about the frames that were not answered yet.

        Detections are in pixels of the image.  A detector with a lag answers late.
        """
        if where is not None and any(by := where.moved_since(self._map)):
            yield from self._answers(self._work.move(by))
        self._open.append(OpenFrame(number, where))
        self._map = where
        yield from self._answers(self._work.step(detector_frame(cells), self._rng))

    def flush(self) -> Iterator[tuple[OpenFrame, list[Estimate]]]:
        """Yield the answers about the last frames."""
        yield from self._answers(self._work.flush())

    def _answers(
        self, answers: list[Declarations],
    ) -> Iterator[tuple[OpenFrame, list[Estimate]]]:
        cell = self._chain.detector.sensor.cell_size_m
        for declared in answers:
            about, found = self._open.popleft(), declared.estimates()
            if about.where is not None and self._map is not None:
                # The cells are those of the newest frame, the image is that of the answer.
                where = replace(about.where, origin=self._map.origin)
                found = [where.in_image(item, cell) for item in found]
            yield about, found

    def thresholds(self) -> dict[str, float]:
        """Return the thresholds in force [nat]."""
        return self._work.thresholds()

    def alarm_rate(self) -> AlarmRate:
        """Return the false-alarm rate that was asked for, and that was measured."""
        operating = self._chain.operating
        return AlarmRate(
            operating.false_alarm_prob if acts('false_alarm_prob', operating) else None,
            self._work.measured())


class TrackerRun:
    """A tracker from frame to frame."""

    def __init__(self, chain: Chain) -> None:
        self._tracker = chain.tracker
        self._state = chain.tracker.init()
        self._rng = stream(chain.seed, 'tracker')
        self._map: FrameMap | None = None

    def step(
        self, detections: list[Estimate], where: FrameMap | None, stamp_s: float,
    ) -> list[Estimate]:
        """Return the confirmed tracks in the next frame, in pixels of the image."""
        cell = self._tracker.sensor.cell_size_m
        if where is not None:
            self._follow(where)
            detections = [where.in_cells(item, cell) for item in detections]
        self._state, output = self._tracker.step(self._state, detections, stamp_s, self._rng)
        if where is None:
            return output.confirmed
        return [where.in_image(item, cell) for item in output.confirmed]

    def _follow(self, where: FrameMap) -> None:
        """Move the tracks along when the cells moved in the scene; drop them after a cut."""
        by, self._map = where.moved_since(self._map), where
        if not overlaps(by, (where.size[1] // where.binning, where.size[0] // where.binning)):
            self._state = self._tracker.restart(self._state)
        elif any(by):
            self._state = self._state.moved(by, self._tracker.sensor.cell_size_m)


def conditioned(
    settings: ConditioningSettings, frames: Iterable[np.ndarray], shape: tuple[int, int],
) -> Iterator[tuple[Conditioned, FrameMap]]:
    """Yield each frame (rows, cols) conditioned, and where its cells lie in it."""
    state = settings.init(shape)
    for frame in frames:
        state, output = settings.step(state, camera_pixels(frame))
        yield output, settings.frame_map(output, FRAME_ID, shape)


def prepared(
    chain: Chain, frames: np.ndarray,
) -> Iterator[tuple[np.ndarray, FrameMap | None, str]]:
    """Yield what a detector gets of each frame, where its cells lie, and what is unusual."""
    if chain.conditioner is None:
        for frame in frames:
            yield frame, None, ''
        return
    for output, where in conditioned(chain.conditioner, frames, frames.shape[1:]):
        yield output.cells, where, output.event
