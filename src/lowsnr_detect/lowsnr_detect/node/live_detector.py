# SPDX-License-Identifier: Apache-2.0
"""A detector with its memory, and how its settings change from one frame to the next."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.frame_map import overlaps
from lowsnr_common.core.records import Estimate
from lowsnr_common.settings.flat_values import flat_values
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_detect.adaptive.adaptive_detector import AdaptiveDetector
from lowsnr_detect.calibration.curve import Curve
from lowsnr_detect.calibration.empty_frames import Progress
from lowsnr_detect.calibration.operating_point import at_operating_point
from lowsnr_detect.calibration.operating_point import curve
from lowsnr_detect.calibration.operating_point import known_curve
from lowsnr_detect.calibration.operating_point import logged_progress
from lowsnr_detect.grid.fixed_lag import flushed
from lowsnr_detect.grid.fixed_lag import lag_of
from lowsnr_detect.parts.detector import Declarations
from lowsnr_detect.parts.detector import Detector
from lowsnr_detect.parts.moved_memory import moved_memory
import numpy as np

Settings = tuple[Detector, DetectionSettings]


class LiveDetector:
    """
    A detector with the thresholds of its operating point, and its memory.

    Parameters
    ----------
    name
        Name it is registered under, for the log.
    settings
        Detector with the threshold that the user set, and its operating point.
    shape
        Rows and columns of a frame.
    log
        Called with a sentence for each event.
    progress
        Called with the share of a calibration that is done; by default it is logged.

    ``map`` is, where ``settings`` ask for it, the statistic of the newest frame, (rows, cols), as
    :meth:`lowsnr_detect.parts.detector.Detector.statistic_map` returns it.

    """

    map: np.ndarray | None = None  # noqa: A003

    def __init__(
        self, name: str, settings: Settings, shape: tuple[int, int], log: Callable[[str], None],
        progress: Progress | None = None,
    ) -> None:
        self.name, self.shape, self._log = name, shape, log
        # By detector, without its threshold.
        self._curves: dict[Detector, Curve] = {}
        detector, operating = settings
        self._mapped = operating.statistic_map
        if operating.operating_point == 'matched':
            self._curves[_untuned(detector)] = curve(
                detector, shape, progress=progress or logged_progress(name, shape, log),
                warn=log)
        self._detector = self._tuned(settings)
        self._start()

    def _start(self) -> None:
        """Start with an empty memory."""
        self._memory = self._detector.init(self.shape)
        self._open = 0  # frames without an answer

    def step(self, frame: np.ndarray, rng: np.random.Generator) -> list[Declarations]:
        """Advance by a frame (rows, cols); return the answer about the oldest open one, if any."""
        before = self._memory
        self._memory, declared = self._detector.step(before, frame, rng)
        if self._mapped:
            self.map = self._detector.statistic_map(before, frame, self._memory)
        self._open += 1
        if self._open <= lag_of(self._detector):
            return []
        self._open -= 1
        return [declared]

    def flush(self) -> list[Declarations]:
        """Return the answers about the frames that have none yet; the memory starts empty."""
        found = flushed(self._detector, self._memory)
        self._start()
        return found

    def move(self, by: tuple[int, int]) -> list[Declarations]:
        """
        Move the memory to cells whose first one moved by rows and columns in the scene.

        After a cut it starts empty; return the answers about the frames before, in their cells.
        """
        if not overlaps(by, self.shape):
            return self.flush()
        self._memory = moved_memory(
            self._memory, self._detector.init(self.shape), self.shape, by,
            self._detector.sensor.cell_size_m)
        return []

    def measured(self) -> float | None:
        """Return the share of frames with a false alarm that an adaptive detector measures."""
        working = self._detector
        return working.measured(self._memory) if isinstance(working, AdaptiveDetector) else None

    def thresholds(self) -> dict[str, float]:
        """Return the thresholds in force [nat], by name; of adaptive ones the largest."""
        if isinstance(self._detector, AdaptiveDetector):
            return {'threshold': self._detector.largest(self._memory)}
        values = flat_values(self._detector)
        return {name: values[name] for name in ('threshold', 'upper_threshold') if name in values}

    def check(self, settings: Settings) -> None:
        """
        Check that other settings can be put in force without a simulation.

        Raises
        ------
        ValueError
            If the operating point is 'matched' and there is no calibration for the settings, in
            this process or on disk, or 'adaptive' and the statistic is not one of cells.

        """
        detector, operating = settings
        if operating.operating_point == 'adaptive':
            AdaptiveDetector(detector, operating.false_alarm_prob, self.shape)
        if operating.operating_point != 'matched' or _untuned(detector) in self._curves:
            return
        if (found := known_curve(detector, self.shape, warn=self._log)) is None:
            rows, cols = self.shape
            raise ValueError(
                f'there is no calibration of {self.name} with these settings for operating_point '
                f"'matched': make it with 'python scripts/calibrate.py --detector {self.name} "
                f"--snr {detector.sensor.snr_db:g} --rows {rows} --cols {cols}' and the other "
                'options of this run, then set it again')
        self._curves[_untuned(detector)] = found

    def change(self, settings: Settings, number: int) -> list[Declarations]:
        """
        Put other settings, which were checked, in force from the frame of a number on.

        The memory is kept unless the sensor model changes, because sums of log ratios for one
        intensity have no meaning for another, or thresholds become adaptive or cease to be.
        Return the answers about the frames before that, where it starts empty.
        """
        detector = self._tuned(settings)
        restarts = (detector.sensor, type(detector)) != (
            self._detector.sensor, type(self._detector))
        before = self.flush() if restarts else []
        self._detector = detector
        if restarts:
            self._start()
        held = ', '.join(f'{name} {value:.2f} nat' for name, value in self.thresholds().items())
        self._log(
            f'in force from frame {number} on: {settings[1].operating_point}, {held}, '
            f'design SNR {detector.sensor.snr_db:g} dB, memory '
            + ('starts empty' if restarts else 'kept'))
        return before

    def _tuned(self, settings: Settings) -> Detector | AdaptiveDetector:
        detector, operating = settings
        if operating.operating_point == 'adaptive':
            return AdaptiveDetector(detector, operating.false_alarm_prob, self.shape)
        found = self._curves.get(_untuned(detector))
        return at_operating_point(self.name, detector, operating, found, self._log)


def in_image(
    declared: Declarations, about: FrameMap | None, newest: FrameMap | None, cell_size_m: float,
) -> list[Estimate]:
    """
    Return declarations as objects in the image of the frame that they are about.

    Parameters
    ----------
    declared
        Declarations in the cells of the newest frame.
    about, newest
        Maps of both frames; None without a conditioner.
    cell_size_m
        Side of a cell [m].

    """
    found = declared.estimates()
    if about is None or newest is None:
        return found
    where = replace(about, origin=newest.origin)
    return [where.in_image(item, cell_size_m) for item in found]


def _untuned(detector: Detector) -> Detector:
    """Return a detector without its threshold, on which its calibration does not depend."""
    return replace(detector, threshold=0.0)
