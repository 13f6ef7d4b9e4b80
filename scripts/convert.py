"""Make a bag from real frames: an .npz, a folder of PNG, TIFF or FITS images, or a video."""

import argparse
from collections.abc import Iterable
import itertools
import math
import os
from pathlib import Path
import shutil
import sqlite3
import sys
from typing import TYPE_CHECKING

from _arguments import INTERRUPTED
from _arguments import number
from _arguments import Parser
from _arguments import USAGE
import _environment

if TYPE_CHECKING:
    from lowsnr_bringup.bags.image_files import FrameReader
    from lowsnr_common.core.records import Truth


MESSAGE_BYTES = 150  # of a frame and its time in a bag, besides the pixels


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
        if os.path.lexists(options.out):
            raise ValueError(f'--out {options.out}: exists')
        frames = open_frames(options.frames)
        begun = True
        count = write(frames, options)
    except ValueError as error:
        print(f'convert.py: {error}', file=sys.stderr)
        return USAGE
    except (OSError, sqlite3.Error) as error:
        reason = getattr(error, 'strerror', None) or error
        print(f'convert.py: {options.out}: {reason}', file=sys.stderr)
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
    truth: Iterable[list[Truth] | None] = itertools.repeat(None)
    if options.truth:
        # The table names the frames by t_s, or by times from 0 s on.
        even_s = frames.even_period_s(period_s)
        times_s = frames.times_s if even_s is None else np.arange(sum(1 for _ in frames)) * even_s
        truth = read_truth(options.truth, np.asarray(times_s))
    elif frames.truth is not None:
        truth = truth_of_array(frames.truth)
    check_room(options.out, frames)
    count = 0
    with FrameBag(options.out, options.storage) as bag:
        for frame, stamp_ns, objects in zip(frames, frames.stamps_ns(period_s), truth):
            bag.add(frame, stamp_ns, objects)
            count += 1
    return count


def check_room(out: Path, frames: 'FrameReader') -> None:
    """Raise ValueError if the disk has no room for the frames, as far as their number is known."""
    each = math.prod(frames.shape) * frames.dtype.itemsize + MESSAGE_BYTES
    size = each * (frames.count or 0)
    folder = next(path for path in out.absolute().parents if path.is_dir())
    if size > (free := shutil.disk_usage(folder).free):
        raise ValueError(
            f'{out}: the bag takes {size} bytes, and the disk of {folder} has {free} free')


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
