# SPDX-License-Identifier: Apache-2.0
"""
A detector's host that is killed and started again, at a size and a rate of frames.

Two network namespaces are the hosts; the machine's load is printed, because both share it.
Needs the right to make namespaces: ``python benchmarks/two_hosts.py --side 1024 --rate 30``.
"""

import argparse
import json
import os
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / 'scripts'), str(ROOT / 'test' / 'support')]
SCENARIO = 'rows: {side}\ncols: {side}\nframes: {frames}\nobjects: []\n'


def measure(folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Run both hosts; return what ``split_run.py`` prints."""
    scenario = folder / 'scene.yaml'
    scenario.write_text(SCENARIO.format(side=options.side, frames=options.frames))
    done = subprocess.run(
        ['unshare', '--map-root-user', '--net', sys.executable,
         str(ROOT / 'test' / 'support' / 'split_run.py'), str(folder), options.event,
         '--scenario', str(scenario), '--rate', str(options.rate),
         '--set', 'sdt.operating_point=nominal'],
        env=os.environ | {'PYTHONPATH': os.pathsep.join(sys.path)}, stdout=subprocess.PIPE,
        text=True, check=True, timeout=1800.0)
    return dict(json.loads(done.stdout))


def main() -> None:
    """Print what became of the frames."""
    parser = argparse.ArgumentParser(description='Kill the host of a detector in a run.')
    parser.add_argument('--side', type=int, default=1024, help='rows and columns (default: 1024)')
    parser.add_argument('--rate', type=float, default=30.0, help='frames a second (default: 30)')
    parser.add_argument('--frames', type=int, default=900, help='(default: 900)')
    parser.add_argument('--event', default='killed', help='as in split_run.py (default: killed)')
    options = parser.parse_args()
    sys.path[:0] = [str(path) for path in (ROOT / 'src').glob('lowsnr*')]
    with TemporaryDirectory() as folder:
        before = os.getloadavg()[0]
        found = measure(Path(folder), options)
    lacking = found['lacking']
    block = lacking == list(range(lacking[0], lacking[-1] + 1)) if lacking else True
    print(f'{options.side} x {options.side} at {options.rate:g} a second, load {before:.1f} to '
          f'{os.getloadavg()[0]:.1f} on {os.cpu_count()} cores')
    print(f'frames: {found["frames"]}')
    print(f'without an answer: {len(lacking)}, all in one block: {block}')
    for key, text in (('start_s', 'back after its start'), ('away_s', 'away')):
        if key in found:
            print(f'{text}: {found[key]:.1f} s')


if __name__ == '__main__':
    main()
