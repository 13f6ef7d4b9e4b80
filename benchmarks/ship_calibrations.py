# SPDX-License-Identifier: Apache-2.0
"""
Write the calibrations that are part of the package: shipped settings and size of frames.

A calibration that still belongs to its detector is kept; ``FULL_RUNS`` runs are simulated for
others, which takes a minute of a core for most detectors and SNRs.
"""

import argparse
from collections.abc import Iterator
import json
from pathlib import Path
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lowsnr_detect.calibration.shipped import Record
    from lowsnr_detect.parts.detector import Detector

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'scripts'))

import _environment  # noqa: E402

# SNRs of most of the shipped scenarios, whose frames have one size [dB].
SNRS_DB = (3.0, 6.0, 9.0)
# Detectors without one: a calibration of PMF takes minutes, and it is a reference for the others.
WITHOUT = {'pmf'}


def main() -> None:
    """Write a file for each class of detectors."""
    _environment.ensure()
    from lowsnr_detect.calibration.shipped import FOLDER
    from lowsnr_detect.parts.registry import detector_class
    from lowsnr_detect.parts.registry import DETECTORS

    detector_class('sdt')  # imports the detectors, which register themselves
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        '--detector', nargs='+', default=sorted({*DETECTORS} - WITHOUT), metavar='NAME')
    FOLDER.mkdir(exist_ok=True)
    for name in parser.parse_args().detector:
        lines = [json.dumps(record(*case), separators=(',', ':')) for case in shipped_cases(name)]
        path = FOLDER / f'{DETECTORS[name].__name__.lower()}.json'
        path.write_text(''.join(f'{line}\n' for line in lines), encoding='utf-8')
        print(f'{path}: {len(lines)} calibrations')


def shipped_cases(name: str) -> 'Iterator[tuple[Detector, tuple[int, int]]]':
    """Yield a detector at unit period with the shipped settings for each SNR, and the size."""
    from calibrate import planned
    from lowsnr_common.settings.frame_period import at_unit_period

    for snr_db in SNRS_DB:
        options = argparse.Namespace(
            detector=[name], scenario='example4', overrides=[], rows=None, cols=None)
        for _, detector, _, shape in planned(options, snr_db, None):
            yield at_unit_period(detector), shape


def record(detector: 'Detector', shape: tuple[int, int]) -> 'Record':
    """Return the record of a detector: the one that there is, or else a new one."""
    from lowsnr_detect.calibration.curve import curve_from_record
    from lowsnr_detect.calibration.effort import FULL_RUNS
    from lowsnr_detect.calibration.shipped import is_replayed
    from lowsnr_detect.calibration.shipped import record_of
    from lowsnr_detect.calibration.shipped import shipped_records
    from lowsnr_detect.calibration.simulated_curve import simulate_curve

    for kept in shipped_records(detector):
        if tuple(kept['curve']['shape']) == shape and is_replayed(detector, kept):
            return record_of(detector, curve_from_record(kept['curve']))
    return record_of(detector, simulate_curve(detector, shape, runs=FULL_RUNS))


if __name__ == '__main__':
    main()
