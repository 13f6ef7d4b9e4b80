# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK
"""Make a bag from real frames: FITS, TIFF, SER, NumPy or image files, a folder, or a video."""

import argparse
import os
from pathlib import Path
import shutil
import sqlite3
import sys

from _arguments import input_path
from _arguments import INTERRUPTED
from _arguments import number
from _arguments import Parser
from _arguments import USAGE
import _environment
from _film_arguments import add_film
from _film_arguments import add_truth
from _film_arguments import reading


def parse_arguments(arguments: list[str]) -> argparse.Namespace:
    """Return the options; ``--help`` and errors end here."""
    parser = Parser(
        prog='convert.py', description=__doc__ + '  Pixels are stored as '
        'they are: unsigned 8 and 16 bits as mono8 and mono16, all others as 32FC1; colour '
        'becomes grey.  docs/real_frames.md lists the formats.',
        epilog='An .npz holds frames [T, H, W] and, if known, truth [T, 2] (x, y in pixels, '
        'NaN for absent) and t_s [T]. example: python scripts/convert.py night.npz --out '
        'bags/night; exit code: 0 done, 2 usage error or unusable frames, 130 after Ctrl-C')
    parser.add_argument('frames', type=input_path, metavar='FRAMES', help='file or folder')
    parser.add_argument(
        '--out', type=Path, required=True, metavar='BAG',
        help='folder of the bag, which must not exist')
    add_film(parser)
    parser.add_argument(
        '--rate', type=number(0.0, above=True), metavar='HZ',
        help='frames a second, in place of --period')
    add_truth(parser)
    parser.add_argument(
        '--storage', choices=('mcap', 'sqlite3'), default='mcap', help='(default: mcap)')
    options = parser.parse_args(arguments)
    if options.rate and options.period_s:
        parser.error('argument --rate: not allowed with argument --period')
    options.period_s = 1.0 / options.rate if options.rate else options.period_s
    return options


def main() -> int:
    """Convert; return the exit code."""
    options = parse_arguments(sys.argv[1:])
    _environment.ensure(('bags', 'files'))
    from lowsnr_bringup.formats.image_files import open_frames
    from lowsnr_bringup.ros.film_bag import write_film
    from lowsnr_common.settings.text import printable
    begun = False
    try:
        if os.path.lexists(options.out):
            raise ValueError(f'--out {options.out}: exists')
        film = open_frames(options.frames, options.select, options.pattern or '*')
        begun = True
        count = write_film(
            film, options.out, options.storage, period_s=options.period_s,
            truth_file=options.truth, reading=reading(options))
    except ValueError as error:
        print(f'convert.py: {error}', file=sys.stderr)
        return USAGE
    except (OSError, sqlite3.Error) as error:
        print(f'convert.py: {options.out}: {getattr(error, "strerror", "") or error}',
              file=sys.stderr)
        return USAGE
    else:
        begun = False
    finally:
        if begun:  # the bag is not complete
            shutil.rmtree(options.out, ignore_errors=True)
    for note in film.notes:
        print(f'convert.py: {printable(note)}', file=sys.stderr)
    print(f'{count} frames in {options.out}')
    return 0


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
