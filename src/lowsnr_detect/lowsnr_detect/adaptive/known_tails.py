# SPDX-License-Identifier: Apache-2.0
"""
Tails in white noise that are known: part of the package, kept on disk, or else simulated.

Those of the package are of many more frames than a start has time for.  One belongs to a detector
whose statistic in a short run of white noise is the one that was stored with it, whatever its
settings and its source: a detector with another statistic is simulated.
"""

from __future__ import annotations

from dataclasses import asdict
import functools
import hashlib
import json
from pathlib import Path
from typing import Any

from lowsnr_common.core.streams import stream
from lowsnr_common.settings.flat_values import flat_values
from lowsnr_common.settings.frame_period import at_unit_period
from lowsnr_detect.adaptive.white_tail import simulated_tail
from lowsnr_detect.adaptive.white_tail import WhiteTail
from lowsnr_detect.calibration.cache import cache_key
from lowsnr_detect.calibration.cache import default_folder
from lowsnr_detect.calibration.cache import load
from lowsnr_detect.calibration.cache import save
from lowsnr_detect.parts.cell_detector import CellDetector
import numpy as np

FOLDER = Path(__file__).parent / 'tails'
# Rows and columns at least and at most: maxima are lower at the edges of small frames.
_LEAST, SIDE = 16, 64
# Frames of each run: simulated at a start, and for the package.
_FRAMES, SHIPPED_FRAMES = 250, 2_000
# Frames of the stored run; rounding differs by far less, a changed statistic by far more.
_REPLAYED, _TOLERANCE = 30, 1e-3

Record = dict[str, Any]


@functools.lru_cache(maxsize=32)
def white_tail(detector: CellDetector, rows: int = SIDE, cols: int = SIDE) -> WhiteTail:
    """
    Return the tail of the local maxima of a statistic in white noise, in frames of a size.

    One that is not part of the package takes about a second to simulate, so that it is kept on
    disk as calibrations are.  The frame period does not matter: that of a camera is measured anew
    at each start.
    """
    rows, cols = (min(max(size, _LEAST), SIDE) for size in (rows, cols))
    detector, folder = at_unit_period(detector), default_folder()
    if (shipped := shipped_tail(detector, rows, cols)) is not None:
        return shipped
    code = b''.join(path.read_bytes() for path in sorted(Path(__file__).parent.glob('*.py')))
    key = cache_key(type(detector), {
        'settings': flat_values(detector), 'shape': [rows, cols],
        'tail': hashlib.sha256(code).hexdigest()})
    if (known := load(folder, key, _ignore)) is not None:
        return _tail(known)
    found = simulated_tail(detector, rows, cols, _FRAMES)
    save(folder, key, asdict(found), _ignore)
    return found


def shipped_tail(
    detector: CellDetector, rows: int, cols: int, folder: Path = FOLDER,
) -> WhiteTail | None:
    """Return the tail of a detector at unit period that is part of the package, if any."""
    records = [
        record for record in shipped_records(detector, folder) if record['shape'] == [rows, cols]]
    if not records:
        return None
    replay = _replay(detector, rows, cols)
    return next((
        _tail(record['tail']) for record in records
        if np.allclose(replay, np.array(record['replay'], float), _TOLERANCE, _TOLERANCE,
                       equal_nan=True)), None)


def shipped_records(detector: CellDetector, folder: Path = FOLDER) -> list[Record]:
    """Return the records of the class of a detector."""
    path = folder / f'{type(detector).__name__.lower()}.json'
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding='utf-8').splitlines()]


def record_of(detector: CellDetector, rows: int, cols: int, frames: int) -> Record:
    """Return the record of a detector at unit period, simulated in so many frames of a size."""
    replay = _replay(detector, rows, cols)
    tail = asdict(simulated_tail(detector, rows, cols, frames))
    return {
        'shape': [rows, cols],
        'replay': [None if np.isnan(value) else float(f'{value:.7g}') for value in replay],
        'tail': {name: _rounded(value) for name, value in tail.items()}}


def _replay(detector: CellDetector, rows: int, cols: int) -> np.ndarray:
    """Return the largest statistic of each frame of a short run, NaN for none, and the reach."""
    rng, state, largest = stream(0, 'calibration'), detector.init((rows, cols)), []
    for _ in range(_REPLAYED):
        noise = detector.sensor.draw_noise((rows, cols), rng)
        state, plane = detector.statistic(state, noise)
        largest.append(float(plane.max()))
    found = np.array([*largest, float(detector.peak_reach)])
    return np.where(np.isfinite(found), found, np.nan)


def _rounded(value: Any) -> Any:
    """Return a number, or each of several, to six digits."""
    return [*map(_rounded, value)] if isinstance(value, tuple) else float(f'{value:.6g}')


def _tail(record: Record) -> WhiteTail:
    values: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in record.items()}
    return WhiteTail(**values)


def _ignore(text: str) -> None:
    """Say nothing of a file that cannot be used or written: it costs a second."""
