"""Make a bag from real frames: an .npz, a folder of PNG, TIFF or FITS images, or a video."""

import argparse
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
    from lowsnr_bringup.bags.image_files import FrameReader


def parse_arguments(arguments: list[str]) -> argparse.Namespace:
    """Return the options; ``--help`` and errors end here."""
    parser = Parser(
        prog='convert.py', allow_abbrev=False, description=__doc__ + '  Pixels are stored as '
        'they are: unsigned 8 and 16 bits as mono8 and mono16, all others as 32FC1; colour '
        'becomes grey.',
        epilog='An .npz holds frames [T, H, W] and, if known, truth [T, 2] (x, y in pixels, '
        'NaN for absent) and t_s [T]. example: python scripts/convert.py night.npz --out '
        'bags/night; exit code: 0 done, 2 usage error or unusable frames, 130 after Ctrl-C')
    parser.add_argument('frames', type=Path, metavar='FRAMES', help='file or folder')
    parser.add_argument(
        '--out', type=Path, required=True, metavar='BAG',
        help='folder of the bag, which must not exist')
    parser.add_argument(
        '--truth', type=Path, metavar='CSV',
        help='table frame,x,y or t_s,x,y, with an id if there are several objects; frames are '
        'numbered from 1, x and y are in pixels')
    pace = parser.add_mutually_exclusive_group()
    pace.add_argument(
        '--period', type=number(0.0, above=True), metavar='S',
        help='time between frames [s] (default: that of t_s or the video, or 1)')
    pace.add_argument(
        '--rate', type=number(0.0, above=True), metavar='HZ',
        help='frames a second, in place of --period')
    parser.add_argument(
        '--storage', choices=('mcap', 'sqlite3'), default='mcap', help='(default: mcap)')
    return parser.parse_args(arguments)


def main() -> int:
    """Convert; return the exit code."""
    _environment.ensure()
    options = parse_arguments(sys.argv[1:])
    from lowsnr_bringup.bags.image_files import open_frames
    begun = False
    try:
        if options.out.exists():
            raise ValueError(f'--out {options.out}: exists')
        frames = open_frames(options.frames)
        begun = True
        count = write(frames, options)
    except ValueError as error:
        print(f'convert.py: {error}', file=sys.stderr)
        return USAGE
    except OSError as error:
        print(f'convert.py: {options.out}: {error.strerror or error}', file=sys.stderr)
        return USAGE
    else:
        begun = False
    finally:
        if begun:  # the bag is not complete
            shutil.rmtree(options.out, ignore_errors=True)
    for note in frames.notes:
        print(f'convert.py: {note}', file=sys.stderr)
    print(f'{count} frames in {options.out}')
    return 0


def write(frames: 'FrameReader', options: argparse.Namespace) -> int:
    """Write the bag; return the number of frames."""
    from lowsnr_bringup.bags.truth_table import read_truth
    from lowsnr_bringup.bags.truth_table import truth_of_array
    from lowsnr_bringup.ros.frame_bag import FrameBag
    import numpy as np

    period_s = 1.0 / options.rate if options.rate else options.period
    truth, rest = None, iter(frames)
    if options.truth:
        held = list(frames)
        rest = iter(held)
        # The table names the frames by t_s, or by times from 0 s on.
        even_s = frames.even_period_s(period_s)
        times_s = frames.times_s if even_s is None else np.arange(len(held)) * even_s
        truth = read_truth(options.truth, np.asarray(times_s))
    elif frames.truth is not None:
        truth = truth_of_array(frames.truth)
    count = 0
    with FrameBag(options.out, options.storage) as bag:
        for frame, stamp_ns in zip(rest, frames.stamps_ns(period_s)):
            bag.add(frame, stamp_ns, None if truth is None else truth[count])
            count += 1
    return count


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
