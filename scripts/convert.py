"""Make a bag of real frames: of an .npz, a folder of PNG, TIFF or FITS images, or a video."""

import argparse
from collections.abc import Iterator
import itertools
from pathlib import Path
import shutil
import sys
from typing import TYPE_CHECKING

from _arguments import INTERRUPTED
from _arguments import number
from _arguments import Parser
from _arguments import USAGE
import _environment

if TYPE_CHECKING:
    from lowsnr_bringup.bags.image_files import Recording
    import numpy as np


def parse_arguments(arguments: list[str]) -> argparse.Namespace:
    """Return the options; ``--help`` and errors end here."""
    parser = Parser(
        prog='convert.py', allow_abbrev=False, description=__doc__ + '  Pixels are stored as '
        'they are: 8 and 16 bits without sign as mono8 and mono16, all others as 32FC1; colour '
        'becomes grey.',
        epilog='An .npz holds frames [T, H, W] and, where known, truth [T, 2] (x, y in pixels, '
        'NaN for absent) and t_s [T]. example: python scripts/convert.py night.npz --out '
        'bags/night; exit code: 0 done, 2 usage error or frames that do not fit, 130 after Ctrl-C')
    parser.add_argument('frames', type=Path, metavar='FRAMES', help='file or folder')
    parser.add_argument(
        '--out', type=Path, required=True, metavar='BAG', help='folder of the bag, not yet there')
    parser.add_argument(
        '--truth', type=Path, metavar='CSV',
        help='table frame,x,y or t_s,x,y, with an id where there are several objects; frames '
        'from 1, x and y in pixels')
    pace = parser.add_mutually_exclusive_group()
    pace.add_argument(
        '--period', type=number(0.0, above=True), metavar='S',
        help='time between frames [s] (default: as t_s or the video has it, or 1)')
    pace.add_argument(
        '--rate', type=number(0.0, above=True), metavar='HZ', help='frames a second, likewise')
    parser.add_argument(
        '--storage', choices=('mcap', 'sqlite3'), default='mcap', help='(default: mcap)')
    return parser.parse_args(arguments)


def main() -> int:
    """Convert; return the exit code."""
    _environment.ensure()
    options = parse_arguments(sys.argv[1:])
    from lowsnr_bringup.bags.image_files import open_recording
    made = False
    try:
        if options.out.exists():
            raise ValueError(f'--out {options.out}: exists')
        recording = open_recording(options.frames)
        made = True
        count = write(recording, options)
    except ValueError as error:
        print(f'convert.py: {error}', file=sys.stderr)
        return USAGE
    except OSError as error:
        print(f'convert.py: {options.out}: {error.strerror or error}', file=sys.stderr)
        return USAGE
    else:
        made = False
    finally:
        if made:  # what did not come to its end is no bag
            shutil.rmtree(options.out, ignore_errors=True)
    for remark in recording.remarks:
        print(f'convert.py: {remark}', file=sys.stderr)
    print(f'{count} frames in {options.out}')
    return 0


def write(recording: 'Recording', options: argparse.Namespace) -> int:
    """Write the bag; return the number of frames."""
    from lowsnr_bringup.bags.truth_table import read_truth
    from lowsnr_bringup.bags.truth_table import truth_of_array
    from lowsnr_bringup.ros.frame_bag import FrameBag

    frames, truth = recording.frames, None
    if recording.truth is not None:
        truth = truth_of_array(recording.truth)
    if options.truth:
        held = list(frames)
        frames = iter(held)
        truth = read_truth(options.truth, times(recording, options, len(held)))
    count = 0
    with FrameBag(options.out, options.storage) as bag:
        for frame, stamp_ns in zip(frames, stamps(recording, options)):
            bag.add(frame, stamp_ns, None if truth is None else truth[count])
            count += 1
    return count


def period(recording: 'Recording', options: argparse.Namespace) -> float | None:
    """Return the time between frames where it is the same throughout, None where t_s rules."""
    if options.rate or options.period:
        return options.period or 1.0 / options.rate
    if recording.times_s is not None and len(recording.times_s) > 1:
        return None
    return recording.period_s or 1.0


def times(
    recording: 'Recording', options: argparse.Namespace, count: int,
) -> 'np.ndarray':
    """Return the times by which a table of truth names the frames: t_s, or from 0 on [s]."""
    import numpy as np

    even_s = period(recording, options)
    if even_s is None and recording.times_s is not None:
        return recording.times_s
    return np.arange(count) * (even_s or 1.0)


def stamps(recording: 'Recording', options: argparse.Namespace) -> Iterator[int]:
    """Return the stamps [ns]: those of t_s, or even ones; the first is a period, never 0."""
    import numpy as np

    even_s = period(recording, options)
    if even_s is not None:
        return (round(k * even_s * 1e9) for k in itertools.count(1))
    times_s = np.asarray(recording.times_s, dtype=float)
    first_s = np.median(np.diff(times_s)) - times_s[0]
    return (round((first_s + t) * 1e9) for t in times_s)


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
