# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK
"""Calibrate detectors to false-alarm probabilities, and keep the curves for later starts."""

import argparse
import sys
from typing import TYPE_CHECKING

from _arguments import CONFIG
from _arguments import detector_name
from _arguments import INTERRUPTED
from _arguments import number
from _arguments import override
from _arguments import Parser
from _arguments import scenario_name
from _arguments import SNR_DB
from _arguments import USAGE
import _environment
from bringup import calibrate_detector

if TYPE_CHECKING:
    from lowsnr_detect.parts.detector import Detector

COLUMNS = (
    'detector', 'SNR dB', 'cells', 'P_FA', 'threshold nat', '95 % interval', 'measured', 'frames')


def parse_arguments(arguments: list[str]) -> argparse.Namespace:
    """Return the options; ``--help`` and errors end here."""
    parser = Parser(
        prog='calibrate.py', description=__doc__ + '  A detector that starts with the same '
        'settings reads its curve from the cache; if there is none, it calibrates at its start.  '
        'A running detector reads it when its settings are changed.',
        epilog='example: python scripts/calibrate.py --detector sdt mmtbd2 --snr 3 6 9; exit '
        'code: 0 done, 1 failed, 2 usage or configuration error, 130 after Ctrl-C')
    parser.add_argument(
        '--detector', nargs='+', type=detector_name, metavar='NAME',
        help='detectors (default: all)')
    parser.add_argument(
        '--scenario', type=scenario_name, default='example4', metavar='NAME|FILE',
        help='scenario that gives frame size and SNR (default: example4)')
    parser.add_argument(
        '--snr', nargs='+', type=number(*SNR_DB), metavar='DB', default=[None],
        help="SNRs that the detectors are designed for [dB] (default: the scenario's)")
    parser.add_argument(
        '--false-alarm-prob', nargs='+', type=number(0.0, 1.0, above=True), metavar='P',
        default=[None], help='fractions of empty frames with any declaration (default: that of '
        'config/detectors.yaml)')
    parser.add_argument(
        '--rows', type=number(1, whole=True), metavar='N', help="rows (default: the scenario's)")
    parser.add_argument(
        '--cols', type=number(1, whole=True), metavar='N',
        help="columns (default: the scenario's)")
    parser.add_argument(
        '--set', action='append', type=override, default=[], metavar='DETECTOR.PARAMETER=VALUE',
        dest='overrides', help='set one parameter of a detector, or of all; may be repeated')
    return parser.parse_args(arguments)


def main() -> int:
    """Calibrate; return the exit code."""
    options = parse_arguments(sys.argv[1:])
    _environment.ensure(())
    try:
        cases = [
            case for snr_db in options.snr for prob in options.false_alarm_prob
            for case in planned(options, snr_db, prob)]
    except ValueError as error:
        say(str(error))
        return USAGE
    print_row(COLUMNS)
    for name, detector, prob, shape in cases:
        found = calibrate_detector(name, detector, prob, shape, say)
        low, high = found.interval
        print_row((
            name, f'{detector.sensor.snr_db:g}', f'{shape[1]} x {shape[0]}', f'{prob:g}',
            f'{found.threshold:.3f}', f'{low:.3f} to {high:.3f}', f'{found.measured_prob:.3g}',
            f'{found.runs} x {found.frames}'))
    return 0


def planned(
    options: argparse.Namespace, snr_db: float | None, prob: float | None,
) -> list[tuple[str, 'Detector', float, tuple[int, int]]]:
    """Return name, detector, false-alarm probability and frame size of each, as in bringup.py."""
    from lowsnr_bringup.plan.run_options import RunOptions
    from lowsnr_bringup.plan.run_plan import plan_run
    from lowsnr_detect.parts.registry import detector_class
    from lowsnr_detect.parts.registry import DETECTORS

    detector_class('sdt')  # imports the detectors, which register themselves
    names = options.detector or sorted(DETECTORS)
    wanted = {'false_alarm_prob': prob, 'rows': options.rows, 'cols': options.cols}
    fixed = [
        f'{name}.{key}={value}' for name in names for key, value in wanted.items()
        if value is not None]
    plan = plan_run(RunOptions(
        detectors=names, scenario=options.scenario, snr_db=snr_db,
        overrides=[*options.overrides, *fixed]), CONFIG)
    cases = []
    for path, detector in plan.detectors.items():
        values = plan.parameters[path]
        name = path.rpartition('/')[2].removesuffix('_detector')
        cases.append((
            name, detector, values['false_alarm_prob'], (values['rows'], values['cols'])))
    return cases


def say(text: str) -> None:
    """Print one line for the user, apart from the table."""
    print(f'calibrate.py: {text}', file=sys.stderr)


def print_row(cells: tuple[str, ...]) -> None:
    """Print one line of the table, at once."""
    print('  '.join(f'{cell:>{width}}' for cell, width in zip(
        cells, (8, 6, 11, 6, 13, 17, 9, 9))), flush=True)


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
