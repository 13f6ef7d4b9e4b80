# SPDX-License-Identifier: Apache-2.0
"""
Run the graph for long, with a fault every few seconds, and see what is left of it.

The scenario is empty, so that the share of frames with a declaration is the false-alarm rate that
the detector was calibrated to.  Faults are drawn from a seed, all kinds equally often: see
``test/support/campaign.py``.
"""

import argparse
from collections.abc import Iterator
import contextlib
from dataclasses import dataclass
from dataclasses import field
import os
from pathlib import Path
import shutil
import signal
import statistics
import sys
import tempfile
import time
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / 'scripts'), str(ROOT / 'test' / 'support')]

import _environment  # noqa: E402

BLOCK = 200
WARM_UP_S = 60.0
# Calibrated are runs of 40 frames from a fresh start, of which SDT with s_m = 5 can declare in 36:
# a detector that runs for long declares as often in those, and so more often in all.
CALIBRATED = 0.01 * 40 / 36
# A threshold rests on 400 frames with a declaration, so that its rate is good to a tenth (95 %).
CALIBRATED_HALF = 0.1 * CALIBRATED


@dataclass
class Soak:
    """What is seen of a long run."""

    # By node: time [s], resident memory [MiB], open files.
    sizes: dict[str, list[tuple[float, float, int]]] = field(default_factory=dict)
    shared: list[tuple[float, int]] = field(default_factory=list)


def main() -> int:
    """Run, print what was seen, and return 0 where all of it is as it should be."""
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False,
        epilog='example: python benchmarks/soak.py --minutes 60 --seed 0')
    parser.add_argument('--minutes', type=float, default=60.0, help='length of the run (60)')
    parser.add_argument('--every', type=float, default=10.0,
                        help='seconds from fault to fault (10)')
    parser.add_argument('--seed', type=int, default=0, help='seed of the faults (0)')
    parser.add_argument('--results', type=Path, help='folder for the results of the run')
    parser.add_argument('--without', nargs='*', default=[], help='kinds of faults to leave out')
    options = parser.parse_args()
    _environment.ensure(dev=True)
    from campaign import Campaign
    from graph_client import GraphClient
    from graph_runs import enter_own_domain
    from graph_runs import start_bringup
    from host_faults import HostFaults
    import numpy as np

    domain = enter_own_domain()
    with tempfile.TemporaryDirectory() as spare:
        folder = options.results or Path(spare) / 'run'
        compiler = shutil.which('cc')
        host = HostFaults(Path(spare), compiler) if compiler else None
        before = dict(os.environ)
        os.environ |= host.environment if host else {}
        with start_bringup(
                folder, '--detector', 'sdt', '--scenario', 'empty', '--loop', '--lockstep',
                domain_id=domain) as run:
            os.environ.clear()
            os.environ |= before
            run.wait_for_rows(200, within_s=600.0)
            soak = Soak()
            with GraphClient(domain) as client:
                campaign = Campaign(
                    run, client, 'sdt', np.random.default_rng(options.seed),
                    host.set_clock if host else None)
                hurt(run, campaign, soak, options)
            run.process.send_signal(signal.SIGINT)
            code, out, err = run.finish()
        print(out.partition('P_D:')[0])
        checks = [*account(run, code, out + err), *faults(campaign, run), *flatness(soak),
                  rate(run, np)]
        for good, text in checks:
            print(f'{"ok  " if good else "NOT "} {text}')
        return 0 if all(good for good, _ in checks) else 1


def hurt(run: Any, campaign: Any, soak: Soak, options: Any) -> None:
    """Inject a fault every so often; each kind once before any comes again."""
    from campaign import KINDS

    kinds = [kind for kind in KINDS if kind not in options.without]
    waiting: list[str] = []
    start = time.monotonic()
    due = start + options.every
    while time.monotonic() < start + 60.0 * options.minutes and run.process.poll() is None:
        campaign.client.spin(1.0)
        look(run, soak, time.monotonic() - start)
        if time.monotonic() >= due:
            due = time.monotonic() + options.every
            waiting = waiting or [str(kind) for kind in campaign.rng.permutation(kinds)]
            campaign.inject(waiting.pop())


def look(run: Any, soak: Soak, now_s: float) -> None:
    """Note memory and open files of every process, and what is in shared memory."""
    import psutil

    for name, pid in {**run.nodes(), 'bringup': run.process.pid}.items():
        with contextlib.suppress(psutil.Error):
            process = psutil.Process(pid)
            soak.sizes.setdefault(name, []).append(
                (now_s, process.memory_info().rss / 2**20, process.num_fds()))
    soak.shared.append((now_s, sum(
        path.stat().st_size for path in Path('/dev/shm').glob('fastrtps_*') if path.exists())))


def account(run: Any, code: int, said: str) -> Iterator[tuple[bool, str]]:
    """Yield whether every frame is accounted for."""
    frames = run.summary()['frames']
    lost = frames.get('lost', 0)
    yield code == 130, f'exit code {code}'
    yield 'Traceback' not in said + ''.join(
        path.read_text() for path in (run.results / 'log').iterdir()), 'no traceback'
    yield (frames['published'] == sum(
        (frames['scored'], frames['unanswered'], frames['unseen'], lost)),
        f'{frames["published"]} frames published = {frames["scored"]} scored + '
        f'{frames["unanswered"]} unanswered + {frames["unseen"]} unseen + {lost} lost')
    yield (len(run.rows()) == 2 * (frames['scored'] + frames['unanswered']),
           'frames.csv has two lines for each that was scored or unanswered')
    run.wait_until_none_is_left()
    yield True, 'no process left'


def faults(campaign: Any, run: Any) -> Iterator[tuple[bool, str]]:
    """Yield the faults, and how soon frames were scored again and nodes were back."""
    for name, count in sorted(campaign.faults.items()):
        yield True, f'{count:6d} x {name}'
    yield True, f'{campaign.faults.total()} faults'
    for kind, seconds in sorted(campaign.recovered_s.items()):
        yield True, f'{kind}: frames scored again after {spread(seconds)}'
    for kind, count in campaign.late.items():
        yield False, f'{kind}: no frames were scored for two minutes ({count} x)'
    down_s = [float(row['down_s']) for row in run.restarts()]
    if down_s:
        yield True, f'nodes that died: back after {spread(down_s)}'


def spread(seconds: list[float]) -> str:
    """Return median, longest and number of some times."""
    return (f'{statistics.median(seconds):.2f} s (median), {max(seconds):.2f} s (longest of '
            f'{len(seconds)})')


def flatness(soak: Soak) -> Iterator[tuple[bool, str]]:
    """Yield whether memory and open files of the last third are those of the first."""
    last_s = soak.shared[-1][0]
    for name, seen in soak.sizes.items():
        thirds = [[row for row in seen if low < row[0] <= high] for low, high in (
            (min(WARM_UP_S, last_s / 6), last_s / 3), (2 * last_s / 3, last_s))]
        if all(thirds):
            (early, files), (late, files_late) = (
                (max(row[1] for row in part), max(row[2] for row in part)) for part in thirds)
            yield (late < 1.1 * early + 4.0 and files_late <= files + 4,
                   f'{name}: at most {early:.1f} then {late:.1f} MiB, {files} then '
                   f'{files_late} open files')
    most = [max(size for when, size in soak.shared if low <= when <= high) / 2**20
            for low, high in ((0.0, last_s / 3), (2 * last_s / 3, last_s))]
    yield most[1] < 2.0 * most[0] + 4.0, (
        f'shared memory: at most {most[0]:.1f} then {most[1]:.1f} MiB')


def rate(run: Any, np: Any) -> tuple[bool, str]:
    """Return whether the false-alarm rate is what was asked for."""
    rows = [row.split(',') for row in run.rows()]
    declared = np.array([int(row[5]) > 0 for row in rows if row[3] == 'detection' and row[5]])
    share = declared.mean()
    # Declarations of one path share frames: blocks, not frames, are independent.
    blocks = declared[:len(declared) // BLOCK * BLOCK].reshape(-1, BLOCK).mean(axis=1)
    half = 1.96 * blocks.std(ddof=1) / np.sqrt(len(blocks))
    return abs(share - CALIBRATED) < np.hypot(half, CALIBRATED_HALF), (
        f'declarations in {100 * share:.2f} % [{100 * (share - half):.2f}, '
        f'{100 * (share + half):.2f}] of {len(declared)} empty frames, calibrated to '
        f'{100 * CALIBRATED:.2f} %')


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
