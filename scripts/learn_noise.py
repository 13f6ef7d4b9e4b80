# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK
"""Learn the distribution of the noise from frames without objects, for noise.model empirical."""

import argparse
from collections.abc import Iterator
import sqlite3
import sys
from typing import Any

from _arguments import input_path
from _arguments import INTERRUPTED
from _arguments import Parser
from _arguments import USAGE
import _environment

# Further frames change quantiles less than the noise of other days does.
MOST_CELLS = 10_000_000


def parse_arguments(arguments: list[str]) -> argparse.Namespace:
    """Return the options; ``--help`` and errors end here."""
    parser = Parser(
        prog='learn_noise.py', description=__doc__ + '  It prints lines for config/common.yaml.  '
        'Frames must be as detectors get them: without a background, or conditioned.',
        epilog='example: python scripts/learn_noise.py bags/empty --frames-topic '
        '/conditioned/image_raw; exit code: 0 done, 2 usage error or unfit frames, 130 after '
        'Ctrl-C')
    parser.add_argument(
        'frames', type=input_path, metavar='FRAMES', help='bag, or files as of convert.py')
    parser.add_argument(
        '--frames-topic', default='/image_raw', metavar='TOPIC',
        help='topic of the frames in a bag (default: /image_raw)')
    return parser.parse_args(arguments)


def main() -> int:
    """Learn, and print what was learned; return the exit code."""
    options = parse_arguments(sys.argv[1:])
    _environment.ensure(('bags', 'files'))
    import numpy as np
    parts, count = [], 0
    try:
        for frame in read(options):
            if frame.any():  # a conditioner begins with blank frames
                parts.append(frame[np.isfinite(frame)].astype(float))
                count += frame.size
            if count >= MOST_CELLS:
                break
        print(learned(np.concatenate([*parts, np.empty(0)])))
    except (ValueError, OSError, sqlite3.Error) as error:
        print(f'learn_noise.py: {options.frames}: {error}', file=sys.stderr)
        return USAGE
    return 0


def read(options: argparse.Namespace) -> Iterator[Any]:
    """Yield the frames of a bag or of files."""
    from lowsnr_bringup.bags import bag_frames
    from lowsnr_bringup.bags.bag_files import is_bag
    from lowsnr_bringup.bags.reader import Bag
    from lowsnr_bringup.formats.image_files import open_frames
    from lowsnr_common.images.image_encodings import pixels_of
    if not is_bag(options.frames):
        yield from open_frames(options.frames, None, '*')
        return
    with Bag(options.frames) as bag:
        topic = options.frames_topic
        bag_frames.check_type(bag, topic, (bag_frames.IMAGE,), '--frames-topic')
        for message in bag.messages({topic}):
            yield pixels_of(bag.read(message))


def learned(cells: Any) -> str:
    """Return the settings of the noise of some cells, as lines of a parameter file."""
    from lowsnr_common.noise.empirical import learned_quantiles
    from lowsnr_common.noise.settings import Noise
    import yaml

    noise = Noise(model='empirical', quantiles=learned_quantiles(cells))
    tree = {'/**': {'ros__parameters': {'sensor': {
        'noise_std': float(f'{cells.std():.6g}'),
        'noise': {'model': noise.model, 'quantiles': list(noise.quantiles)}}}}}
    return yaml.safe_dump(tree, default_flow_style=None, sort_keys=False, width=99).rstrip()


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
