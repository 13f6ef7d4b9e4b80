# SPDX-License-Identifier: Apache-2.0
"""The options that say how frames and truth in files are read."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from _arguments import input_path
from _arguments import number
from _arguments import Parser

if TYPE_CHECKING:
    from lowsnr_bringup.truth.frame_index import Reading

# Options that have a meaning for files of frames alone.
_OF_FILMS = {'select': '--select', 'pattern': '--pattern', 'period_s': '--period'}
_COLUMNS = ('frame', 't_s', 'x', 'y', 'id')


def add_film(parser: argparse.ArgumentParser) -> None:
    """Add the options about the frames of files."""
    parser.add_argument(
        '--select', metavar='NAME',
        help='array of an .npz (default: frames, or the only one that can be), or name or number '
        'of the extensions of FITS files (default: all images of one shape, without masks and '
        'errors)')
    parser.add_argument(
        '--pattern', metavar='GLOB',
        help="names of the files of a folder that are read, such as '*.png' (default: all)")
    parser.add_argument(
        '--period', type=number(0.0, above=True), metavar='S', dest='period_s',
        help='time between frames [s] (default: as the files state it, or 1)')


def add_truth(parser: Parser) -> None:
    """Add the options about truth that comes in a file of its own."""
    parser.add_argument(
        '--truth', type=input_path, metavar='FILE',
        help='where the objects are: a CSV table with columns such as frame,x,y or t_s,x,y and '
        'id, a MOT table, or COCO annotations; x and y are in pixels')
    parser.add_argument(
        '--truth-columns', type=columns, default=(), metavar='WHAT=NAME,...',
        help=f'names of columns of the table for {", ".join(_COLUMNS)}')
    parser.add_argument(
        '--truth-from', type=int, choices=(0, 1), metavar='0|1',
        help='number of the first frame in the table (default: 1, or 0 if it has a frame 0)')
    parser.add_argument(
        '--truth-origin', type=int, choices=(0, 1), metavar='0|1',
        help='coordinate of the first pixel in the table (default: 0, of a MOT table 1)')
    parser.only_with('--truth', '--truth-columns', '--truth-from', '--truth-origin')


def columns(text: str) -> tuple[tuple[str, str], ...]:
    """Return the columns of an option ``x=U,y=V``."""
    pairs = tuple(
        (what.strip(), name.strip()) for what, _, name in
        (part.partition('=') for part in text.split(',')))
    if not all(what in _COLUMNS and name for what, name in pairs):
        raise argparse.ArgumentTypeError(
            f'{text!r} is not WHAT=NAME,... with {", ".join(_COLUMNS)}')
    return pairs


def reading(options: argparse.Namespace) -> 'Reading':
    """Return how truth is read, from the options."""
    from lowsnr_bringup.truth.frame_index import Reading
    return Reading(
        columns=options.truth_columns, first=options.truth_from, origin=options.truth_origin)


def films(options: argparse.Namespace, folder: Path) -> list[str]:
    """Make a bag of what is replayed, where it is none; return what the user should know."""
    if options.replay is None:
        return []
    from lowsnr_bringup.ros.film_bag import is_film_only
    from lowsnr_bringup.ros.film_bag import replayable
    given = [option for name, option in _OF_FILMS.items() if getattr(options, name)]
    if given and not is_film_only(options.replay):
        raise ValueError(f'{given[0]}: only with files of frames, and {options.replay} is none')
    found = replayable(
        options.replay, folder, select=options.select, pattern=options.pattern or '*',
        period_s=options.period_s, truth_file=options.truth, reading=reading(options),
        frames_topic=options.frames_topic)
    options.replay, options.truth_bag = found.bag, found.truth_bag
    return found.notes
