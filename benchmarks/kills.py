# SPDX-License-Identifier: Apache-2.0
"""
Kill the nodes of running graphs with SIGKILL, and measure how soon each is back.

The kills are spread evenly over the nodes and over four kinds of run: lockstep and paced runs on
frames of 20 x 20 cells, lockstep runs on frames of 512 x 512, in which a node spends much of its
time sending or receiving, and paced runs on a machine whose clock was set back by a day.  The
moments are drawn from a seed.  A run is over after a few kills of each node, by Ctrl-C, because
bring-up gives up a node that dies more than five times a minute.
"""

import argparse
from collections import defaultdict
import os
from pathlib import Path
import shutil
import signal
import statistics
import sys
import tempfile
import time
from typing import TYPE_CHECKING

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / 'scripts'), str(ROOT / 'test' / 'support')]

import _environment  # noqa: E402

if TYPE_CHECKING:
    from graph_runs import GraphRun
    import numpy as np

NODES = ('sensor_node', 'detector_node', 'tracker_node', 'evaluator_node')
BACK_WITHIN_S = {'detector_node': 2.0, 'tracker_node': 2.0}
KILLS_A_NODE = 3
SCENARIO = '{{frames: 100, rows: {side}, cols: {side}, snr_db: 12.0, objects: []}}'
KINDS = {
    'lockstep': (20, ('--lockstep',)), 'paced': (20, ('--rate', '50')),
    'large frames': (512, ('--lockstep',)), 'clock set back': (20, ('--rate', '50'))}
# What a kill is followed by: the node is active again, and a frame is scored.
Times = dict[str, list[tuple[float, float]]]


def main() -> int:
    """Kill, print the times, and return 0 where every node came back in time."""
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False,
        epilog='example: python benchmarks/kills.py --kills 200 --seed 0')
    parser.add_argument('--kills', type=int, default=200, help='number of kills (200)')
    parser.add_argument('--seed', type=int, default=0, help='seed of the moments (0)')
    options = parser.parse_args()
    _environment.ensure(dev=True)
    import numpy as np

    rng = np.random.default_rng(options.seed)
    found: Times = defaultdict(list)
    kinds = [kind for kind in KINDS if kind != 'clock set back' or shutil.which('cc')]
    done = number = 0
    while done < options.kills:
        kind = kinds[number % len(kinds)]
        left = min(KILLS_A_NODE, -(-(options.kills - done) // len(NODES)))
        with tempfile.TemporaryDirectory() as folder:
            kill_all(kind, Path(folder), left, rng, found)
        done, number = done + left * len(NODES), number + 1
        print(f'{done} kills, the last {left * len(NODES)} in a run of the kind: {kind}',
              flush=True)
    return report(found)


def kill_all(kind: str, folder: Path, times: int, rng: 'np.random.Generator',
             found: Times) -> None:
    """Start a graph, kill each of its nodes a few times in random order, and end it."""
    from graph_runs import own_domain
    from graph_runs import start_bringup
    from host_faults import HostFaults

    side, arguments = KINDS[kind]
    scenario = folder / 'empty.yaml'
    scenario.write_text(SCENARIO.format(side=side), encoding='utf-8')
    host = HostFaults(folder, shutil.which('cc')) if kind == 'clock set back' else None
    before = dict(os.environ)
    os.environ |= host.environment if host else {}
    try:
        with start_bringup(
                folder / 'run', '--detector', 'cdt', '--scenario', str(scenario), '--loop',
                *arguments, domain_id=own_domain()) as run:
            run.wait_for_rows(20)
            for hours in (24, 0):
                if host is not None:
                    host.set_clock(hours)
                    run.wait_for_rows(len(run.rows()) + 20)
            for module in (str(name) for _ in range(times) for name in rng.permutation(NODES)):
                time.sleep(float(rng.uniform(0.0, 0.5)))
                found[module].append(kill(run, module))
            run.process.send_signal(signal.SIGINT)
            code, _, err = run.finish()
            if code != 130:
                raise RuntimeError(f'the run ended with {code}: {err}')
            run.wait_until_none_is_left()
    finally:
        os.environ.clear()
        os.environ |= before


def kill(run: 'GraphRun', module: str) -> tuple[float, float]:
    """Kill a node; return after what times it was active and a frame was scored [s]."""
    restarts = len(run.restarts())
    start = time.monotonic()
    run.kill(module)
    run.wait_for_restarts(restarts + 1)
    back_s = float(run.restarts()[-1]['down_s'])
    run.wait_for_rows(len(run.rows()) + 1)
    return back_s, time.monotonic() - start


def report(found: Times) -> int:
    """Print the times of each node; return 1 where one was not back in time."""
    late = 0
    for module, times in found.items():
        back, scored = zip(*times, strict=True)
        late += sum(each > BACK_WITHIN_S.get(module, float('inf')) for each in back)
        print(f'{module:<16} {len(times)} kills: back after {statistics.median(back):.2f} s '
              f'(longest {max(back):.2f}), next frame scored after '
              f'{statistics.median(scored):.2f} s (longest {max(scored):.2f})')
    print(f'{sum(map(len, found.values()))} kills, none without recovery; {late} later than '
          f'{max(BACK_WITHIN_S.values()):g} s of detector and tracker')
    return 1 if late else 0


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
