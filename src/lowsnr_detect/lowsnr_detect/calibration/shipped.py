# SPDX-License-Identifier: Apache-2.0
"""
Curves that are part of the package: of the shipped settings, for most of the shipped scenarios.

A curve on disk belongs to the settings and the frame size that it was simulated with.  Whether it
belongs to the code as well is seen by a replay: one run of 40 frames is simulated again, and its
statistic must be the one that was stored.  A detector whose statistic has changed is calibrated
again, and one whose source merely looks different is not.
"""

from __future__ import annotations

from dataclasses import replace
import hashlib
import json
from pathlib import Path
from typing import Any

from lowsnr_common.settings.flat_values import flat_values
from lowsnr_detect.calibration.curve import Curve
from lowsnr_detect.calibration.curve import curve_from_record
from lowsnr_detect.calibration.empty_frames import empty_frame_peaks
from lowsnr_detect.calibration.empty_frames import Simulation
from lowsnr_detect.parts.detector import Detector
import numpy as np

FOLDER = Path(__file__).parent / 'curves'
# The false-alarm probability at whose threshold a run is replayed: a threshold that acts on the
# memory then does so in many of its frames.
_REPLAY_PROB = 0.5
# Rounding differs between processors by far less, a changed statistic by far more.
_TOLERANCE = 1e-3

Record = dict[str, Any]


def shipped_curve(
    detector: Detector, shape: tuple[int, int], folder: Path = FOLDER,
) -> Curve | None:
    """Return the curve of a detector at unit period and a frame size; None if none is shipped."""
    settings = _settings_digest(detector, shape)
    for record in shipped_records(detector, folder):
        if record['settings'] == settings and is_replayed(detector, record):
            return curve_from_record(record['curve'])
    return None


def shipped_records(detector: Detector, folder: Path = FOLDER) -> list[Record]:
    """Return the records of the class of a detector."""
    path = folder / f'{type(detector).__name__.lower()}.json'
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding='utf-8').splitlines()]


def is_replayed(detector: Detector, record: Record) -> bool:
    """Return whether a detector has the statistic that a record was made with."""
    stored = np.array(record['replay'], dtype=float)  # null is NaN, for -inf
    found = _replay(detector, curve_from_record(record['curve']))
    return np.allclose(
        np.where(np.isneginf(found), np.nan, found), stored, _TOLERANCE, _TOLERANCE,
        equal_nan=True)


def record_of(detector: Detector, curve: Curve) -> Record:
    """Return the record of a detector at unit period and its curve."""
    columns = {
        name: [float(f'{value:.5g}') for value in getattr(curve, name)]
        for name in ('low', 'high', 'measured_prob')}
    replay = [
        float(f'{value:.7g}') if np.isfinite(value) else None
        for value in _replay(detector, curve).tolist()]
    return {
        'settings': _settings_digest(detector, curve.shape), 'replay': replay,
        'curve': {**curve.record(), **columns}}


def _replay(detector: Detector, curve: Curve) -> np.ndarray:
    """Return the statistic of a run of a detector with a threshold of its curve, (frames,)."""
    threshold = curve.at(_REPLAY_PROB).threshold
    simulation = Simulation(1, curve.frames, curve.simulated_shape, curve.seed)
    peaks = empty_frame_peaks(replace(detector, threshold=threshold), simulation)
    return peaks.ravel()


def _settings_digest(detector: Detector, shape: tuple[int, int]) -> str:
    """Return a digest of what a curve belongs to."""
    settings = flat_values(detector)
    del settings['threshold']
    text = json.dumps([type(detector).__module__, settings, list(shape)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
