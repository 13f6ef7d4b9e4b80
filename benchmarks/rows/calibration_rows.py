# SPDX-License-Identifier: Apache-2.0
"""Rows of first calibrations: for settings that neither the package nor the cache has."""

import functools
from pathlib import Path
import tempfile
import time

import calibrate
from lowsnr_detect.calibration.operating_point import calibrated
from lowsnr_detect.parts.registry import DETECTORS
from rows.row import Figure
from rows.row import Measurement

# The package has the thresholds of 3, 6 and 9 dB.
SNR_DB = 8.0
EIGHT = ('auto', 'bank', 'bernoulli', 'cdt', 'cusum', 'hmm', 'mmtbd2', 'sdt')
EIGHT_S, SMALL_S, ANY_S = 60.0, 10.0, 30.0
SMALL = (20, 20)
LARGER = {'sdt': (64, 96), 'hmm': (96, 96), 'mmtbd2': (96, 96)}


def measurements() -> list[Measurement]:
    """Return the rows; their times are of processors, all threads together."""
    what = 'first calibration, '
    return [
        Measurement(f'{what}20 x 20, {", ".join(EIGHT)}', f'{EIGHT_S:g} s', eight),
        Measurement(f'{what}20 x 20, any detector', f'{SMALL_S:g} s each', any_small),
        *(Measurement(f'{what}{rows} x {cols}, {name}', f'{ANY_S:g} s',
                      functools.partial(larger, name, (rows, cols)))
          for name, (rows, cols) in LARGER.items())]


def eight() -> Figure:
    """Add up the times of eight detectors."""
    spent = sum(seconds(name, SMALL) for name in EIGHT)
    return Figure(f'{spent:.1f} s', spent <= EIGHT_S)


def any_small() -> Figure:
    """Time every registered detector, on its own."""
    found = {name: seconds(name, SMALL) for name in sorted(DETECTORS)}
    shown = ', '.join(f'{name} {spent:.1f}' for name, spent in found.items())
    return Figure(f'{max(found.values()):.1f} s ({shown})', max(found.values()) <= SMALL_S)


def larger(name: str, shape: tuple[int, int]) -> Figure:
    """Time a detector in a larger frame."""
    spent = seconds(name, shape)
    return Figure(f'{spent:.1f} s', spent <= ANY_S)


@functools.cache
def seconds(name: str, shape: tuple[int, int]) -> float:
    """Return the processor time of the first calibration of a detector [s]."""
    options = calibrate.parse_arguments([
        '--detector', name, '--rows', str(shape[0]), '--cols', str(shape[1])])
    ((_, detector, prob, _),) = calibrate.planned(options, SNR_DB, None)
    with tempfile.TemporaryDirectory() as folder:
        start = time.process_time()
        calibrated(detector, prob, shape, folder=Path(folder))
        return time.process_time() - start
