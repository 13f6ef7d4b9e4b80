# SPDX-License-Identifier: Apache-2.0
"""
Write the tails in white noise that are part of the package, for adaptive thresholds.

They are those of every statistic of cells at the shipped settings, for usual design SNRs.  One
that still belongs to its statistic is kept; another takes five seconds of a core.  Delete the
files to make all of them again.
"""

import argparse
from collections.abc import Iterator
import json
from pathlib import Path
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lowsnr_detect.parts.cell_detector import CellDetector

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'scripts'))

import _environment  # noqa: E402

# Design SNRs [dB]: that of the examples of real frames, and those around it.
SNRS_DB = (3.0, 6.0, 8.0, 9.0, 10.0, 12.0)


def main() -> None:
    """Write a file for each class of statistics."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    _environment.ensure()
    from lowsnr_detect.adaptive.known_tails import FOLDER
    from lowsnr_detect.adaptive.known_tails import record_of
    from lowsnr_detect.adaptive.known_tails import SHIPPED_FRAMES
    from lowsnr_detect.adaptive.known_tails import shipped_tail
    from lowsnr_detect.adaptive.known_tails import SIDE

    FOLDER.mkdir(exist_ok=True)
    for detector in tail_cases():
        # Statistics that do not depend on the SNR, or belong to two detectors, have one record.
        if shipped_tail(detector, SIDE, SIDE) is None:
            line = json.dumps(
                record_of(detector, SIDE, SIDE, SHIPPED_FRAMES), separators=(',', ':'))
            path = FOLDER / f'{type(detector).__name__.lower()}.json'
            with path.open('a', encoding='utf-8') as file:
                file.write(f'{line}\n')
            print(f'{path}: {detector.sensor.snr_db:g} dB', flush=True)


def tail_cases() -> 'Iterator[CellDetector]':
    """Yield the statistics of the detectors of cells at unit period, for each SNR."""
    from calibrate import planned
    from lowsnr_common.settings.frame_period import at_unit_period
    from lowsnr_detect.adaptive.adaptive_detector import statistics
    from lowsnr_detect.parts.cell_detector import CellDetector
    from lowsnr_detect.parts.registry import detector_class
    from lowsnr_detect.parts.registry import DETECTORS

    detector_class('sdt')  # imports the detectors, which register themselves
    names = [name for name in sorted(DETECTORS) if issubclass(DETECTORS[name], CellDetector)]
    for snr_db in SNRS_DB:
        options = argparse.Namespace(
            detector=names, scenario='example4', overrides=[], rows=None, cols=None)
        for _, detector, _, _ in planned(options, snr_db, None):
            assert isinstance(detector, CellDetector)
            yield from map(at_unit_period, statistics(detector))


if __name__ == '__main__':
    main()
