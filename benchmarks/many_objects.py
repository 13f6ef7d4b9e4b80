# SPDX-License-Identifier: Apache-2.0
"""
Time and score the tracker on many objects in a large frame.

Objects start anywhere in the frame, move as in the tracker's model and turn back at its edge;
false detections lie anywhere.  The scores of true and false detections are distributed as those of
a detector: log odds exponential with means of 5 and 1.  Times are of one core.
"""

import argparse
import os
from pathlib import Path
import sys

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / 'scripts'), str(ROOT / 'test')]

import _environment  # noqa: E402

SETTLED = 20  # frames before the first that is timed and scored


def main() -> int:
    """Measure, and print a line for each number of objects and particles."""
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False)
    parser.add_argument('--objects', type=int, nargs='+', default=[50, 200, 500])
    parser.add_argument('--particles', type=int, nargs='+', default=[500, 2000])
    parser.add_argument('--side', type=int, default=1024, help='rows and columns (1024)')
    parser.add_argument('--false', type=float, default=50.0, help='false detections a frame (50)')
    parser.add_argument('--frames', type=int, default=60)
    parser.add_argument('--seed', type=int, default=0)
    options = parser.parse_args()
    _environment.ensure()
    os.environ |= {'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'}
    from lowsnr_track.pda_mmpf import PdaMmpf
    import many_scene
    import numpy as np

    print('objects  particles  ms a frame  90 %  tracks  hit  false tracks  id changes/100 frames'
          '  RMSE m')
    for objects in options.objects:
        for particles in options.particles:
            tracker = many_scene.sized(PdaMmpf(), options.side, particles, objects)
            found = many_scene.measure(
                tracker, objects, options.false, options.frames, SETTLED, options.seed)
            middle, high = 1000.0 * np.quantile(found.seconds, [0.5, 0.9])
            print(f'{objects:7} {particles:10} {middle:11.1f} {high:5.0f} '
                  f'{found.tracks.mean():7.0f} {found.hit:6.3f} {found.false:9.2f} '
                  f'{found.changes:13.2f} {found.rmse:17.3f}', flush=True)
    return 0


if __name__ == '__main__':
    sys.exit(main())
