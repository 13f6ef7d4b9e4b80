# SPDX-License-Identifier: Apache-2.0
"""
Detectors at their operating point: nominal, manual, or calibrated to a false-alarm probability.

Detectors compare only at the same fraction of empty frames with a declaration, and no closed
form gives it for any but the simplest, so it is simulated.  The curves of threshold against
false-alarm probability are kept on disk from one start to the next.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math
from pathlib import Path
from typing import Any
from typing import TypeVar
import warnings

from lowsnr_common.settings.flat_values import flat_values
from lowsnr_common.settings.frame_period import at_unit_period
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_detect.calibration.cache import cache_key
from lowsnr_detect.calibration.cache import default_folder
from lowsnr_detect.calibration.cache import load
from lowsnr_detect.calibration.cache import save
from lowsnr_detect.calibration.cache import Warn
from lowsnr_detect.calibration.curve import Calibration
from lowsnr_detect.calibration.curve import Curve
from lowsnr_detect.calibration.curve import curve_from_record
from lowsnr_detect.calibration.empty_frames import Progress
from lowsnr_detect.calibration.shipped import shipped_curve
from lowsnr_detect.calibration.simulated_curve import simulate_curve
from lowsnr_detect.parts.detector import Detector

D = TypeVar('D', bound=Detector)
# Progress is logged at every fifth of the work.
_STEPS = 5


def calibrate(
    detector: Detector, false_alarm_prob: float, shape: tuple[int, int], **options: Any,
) -> Calibration:
    """
    Simulate the threshold at which a given fraction of empty frames holds a declaration.

    Parameters
    ----------
    detector, shape, **options
        As for :func:`lowsnr_detect.calibration.simulated_curve.simulate_curve`.
    false_alarm_prob
        Wanted fraction of empty frames with any declaration, in (0, 1).

    """
    return simulate_curve(detector, shape, **options).at(false_alarm_prob)


def calibrated(
    detector: Detector, false_alarm_prob: float, shape: tuple[int, int], *,
    folder: Path | None = None, progress: Progress | None = None, warn: Warn = warnings.warn,
    **options: Any,
) -> Calibration:
    """Return what :func:`calibrate` does, from the curve on disk if there is one."""
    found = curve(detector, shape, folder=folder, progress=progress, warn=warn, **options)
    return found.at(false_alarm_prob)


def curve(
    detector: Detector, shape: tuple[int, int], *, folder: Path | None = None,
    progress: Progress | None = None, warn: Warn = warnings.warn, **options: Any,
) -> Curve:
    """
    Return the curve of a detector: from disk, or from the package or simulated, and kept there.

    Parameters
    ----------
    detector, shape, progress, **options
        As for :func:`lowsnr_detect.calibration.simulated_curve.simulate_curve`; ``progress`` is
        not called for a curve on disk.
    folder
        Folder of the curves; by default the user's.
    warn
        Receives a line for a file that cannot be used, and for one that cannot be written.

    """
    detector = at_unit_period(detector)
    found = known_curve(detector, shape, folder=folder, warn=warn, **options)
    if found is None:
        found = simulate_curve(detector, shape, progress=progress, **options)
        save(folder or default_folder(), _key(detector, shape, options), found.record(), warn)
    return found


def known_curve(
    detector: Detector, shape: tuple[int, int], *, folder: Path | None = None,
    warn: Warn = warnings.warn, **options: Any,
) -> Curve | None:
    """
    Return the curve of a detector if it is on disk and sound, or part of the package, else None.

    One that is part of the package is kept on disk, where its code need not be looked at again.
    """
    detector, kept = at_unit_period(detector), folder or default_folder()
    key = _key(detector, shape, options)
    record = load(kept, key, warn)
    if record is not None:
        return curve_from_record(record)
    found = None if options else shipped_curve(detector, shape)
    if found is not None:
        save(kept, key, found.record(), warn)
    return found


def at_operating_point(
    name: str, detector: D, operating: DetectionSettings, found: Curve | None,
    log: Callable[[str], None],
) -> D:
    """
    Return the detector with the thresholds of its operating point.

    Parameters
    ----------
    name
        Name it is registered under, for the log.
    detector
        Detector with the threshold that the user set.
    operating
        Operating point and false-alarm probability.
    found
        Curve of the detector; needed for the operating point 'matched'.
    log
        Called with the threshold that was looked up, as a sentence.

    """
    if operating.operating_point == 'nominal':
        return detector.nominal()
    if operating.operating_point == 'manual' or found is None:
        return detector
    at = found.at(operating.false_alarm_prob)
    log(f'{name}: threshold {at.threshold:.2f} nat (95 %: {at.interval[0]:.2f} to '
        f'{at.interval[1]:.2f}) for {at.false_alarm_prob:g} false alarms a frame of '
        f'{at.shape[1]} x {at.shape[0]} cells')
    return replace(detector, threshold=at.threshold)


def logged_progress(
    name: str, shape: tuple[int, int], log: Callable[[str], None],
) -> Progress:
    """Return a progress callback that logs every fifth of a calibration."""
    logged = -1

    def progress(done: float) -> None:
        nonlocal logged
        step = math.floor(done * _STEPS)
        if step > logged:
            logged = step
            log(f'{name}: calibrating for frames of {shape[1]} x {shape[0]} cells, '
                f'{100 * step // _STEPS} % done')

    return progress


def _key(detector: Detector, shape: tuple[int, int], options: dict[str, Any]) -> str:
    """
    Return the name of a curve on disk.

    The threshold of the detector does not matter, nor does the frame period, which is 1 here: of
    a camera it is measured anew at each start.
    """
    settings = flat_values(detector)
    del settings['threshold']
    return cache_key(type(detector), {
        'settings': settings, 'shape': list(shape), 'options': options})
