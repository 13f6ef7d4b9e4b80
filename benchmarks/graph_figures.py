# SPDX-License-Identifier: Apache-2.0
"""
The whole graph: frames a second, latency, start, recovery and memory, beside a round trip.

Everything runs on this machine's real middleware, in a ROS domain of its own.
"""

import argparse
from collections.abc import Iterator
import contextlib
import csv
import os
from pathlib import Path
import signal
import statistics
import sys
import tempfile
import time
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / 'scripts'), str(ROOT / 'test' / 'support'), str(ROOT / 'benchmarks')]

import _environment  # noqa: E402

DOMAIN = 99
SCENARIO = """
frames: {frames}
rows: {side}
cols: {side}
snr_db: 9.0
objects: []
"""
SDT = ('--detector', 'sdt', '--set', 'sdt.max_iterations=5')
# Sensor to detector, detector to tracker.
HOPS = 2


def main() -> int:
    """Measure and print; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False,
        epilog='example: python benchmarks/graph_figures.py --seconds 60')
    parser.add_argument('--seconds', type=int, default=60, help='length of the paced run (60)')
    parser.add_argument('--side', type=int, default=1024, help='side of the large frames (1024)')
    parser.add_argument(
        '--memory-frames', type=int, default=100_000, help='length of the memory run (100000)')
    options = parser.parse_args()
    _environment.ensure()
    os.environ |= {'ROS_DOMAIN_ID': str(DOMAIN), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    for figures in (start_time(), recovery(), small(), large(options.side, options.seconds),
                    memory(options.memory_frames)):
        for what, value, goal in figures:
            print(f'{what:<62} {value:<28} {goal}', flush=True)
    return 0


def start_time() -> Iterator[tuple[str, str, str]]:
    """Time from the command to the first scored frame, second start."""
    times = []
    for _ in range(4):
        with graph(20, 5, '--lockstep') as run:
            start = time.monotonic()
            run.wait_for_rows(1)
            times.append(time.monotonic() - start)
            done(run)
    yield 'start, warm: command to first frame scored', f'{min(times[1:]):.2f} s', '2 s'


def small() -> Iterator[tuple[str, str, str]]:
    """Latency at 20 x 20 beside the bare round trip."""
    from round_trip import round_trips

    bare = statistics.median(round_trips(20, 500))
    for way, goal in ((), '4'), (('--composed',), '0.8 ms'):
        with graph(20, 500, '--rate', '50', *way) as run:
            done(run)
            found = statistics.median(latencies(run))
        yield (f'20 x 20{" composed" * bool(way)}: frame to track, over round trip x hops',
               f'{found / (1e3 * bare * HOPS):.1f} ({found:.2f} ms, {1e3 * bare:.2f} ms)', goal)


def large(side: int, seconds: int) -> Iterator[tuple[str, str, str]]:
    """Rate in lockstep, and latency at 30 frames a second."""
    from round_trip import round_trips

    bare = 1e3 * statistics.median(round_trips(side, 50))
    yield f'{side} x {side}: bare round trip', f'{bare:.1f} ms', ''
    frames = 30 * seconds
    with graph(side, frames, '--lockstep') as run:
        run.wait_for_rows(2 * 10)
        start, first = time.monotonic(), len(run.rows())
        run.wait_for_rows(2 * (frames - 1))
        rate = (len(run.rows()) - first) / 2 / (time.monotonic() - start)
        done(run)
    yield f'{side} x {side}: frames a second in lockstep', f'{rate:.1f}', '100'
    with graph(side, frames, '--rate', '30') as run:
        done(run)
        scored = run.summary()['frames']
        spent = latencies(run)
    yield (f'{side} x {side}: 30 a second for {seconds} s: unanswered',
           f'{scored["unanswered"]} of {scored["published"]}', '0')
    yield (f'{side} x {side}: frame to track, median and 99 %',
           f'{statistics.median(spent):.1f}, {statistics.quantiles(spent, n=100)[-1]:.1f} ms',
           '60 ms')


def recovery() -> Iterator[tuple[str, str, str]]:
    """Time from the death of a node to its answers, the first death in a run."""
    down: dict[str, list[float]] = {'detector_node': [], 'tracker_node': []}
    for _ in range(3):
        with graph(20, 40, '--lockstep', '--loop') as run:
            run.wait_for_rows(20)
            for count, (module, times) in enumerate(down.items(), start=1):
                run.kill(module)
                run.wait_for_restarts(count)
                times.append(float(run.restarts()[-1]['down_s']))
                run.wait_for_rows(len(run.rows()) + 20)
            run.process.send_signal(signal.SIGINT)
            run.finish()
    for module, times in down.items():
        yield (f'{module} killed: back after, median and longest of {len(times)}',
               f'{statistics.median(times):.2f}, {max(times):.2f} s', '2 s')


def memory(frames: int) -> Iterator[tuple[str, str, str]]:
    """Resident memory of each node early and late in a long run."""
    import psutil

    with graph(20, frames, '--lockstep') as run:
        early: dict[str, float] = {}
        while run.process.poll() is None:
            now = {name: psutil.Process(pid).memory_info().rss / 2**20
                   for name, pid in run.nodes().items()}
            rows = len(run.rows()) / 2
            if rows > frames / 10 and not early:
                early = now
            if now and rows < 0.98 * frames:
                late = now
            time.sleep(2.0)
        done(run)
    for name, size in late.items():
        yield (f'memory of {name} after {frames // 10} and {frames} frames',
               f'{early.get(name, float("nan")):.1f}, {size:.1f} MiB', 'flat')


def latencies(run: Any) -> list[float]:
    """Return the time from frame to track of every frame [ms], after the first ten."""
    with (run.results / 'latency.csv').open(encoding='utf-8', newline='') as file:
        return [float(row['latency_ms']) for row in csv.DictReader(file)][10:]


def done(run: Any) -> None:
    """Wait for the end of a run that must succeed."""
    code, _, err = run.finish(within_s=3600.0)
    if code:
        raise RuntimeError(err)


@contextlib.contextmanager
def graph(side: int, frames: int, *arguments: str) -> Iterator[Any]:
    """Start the graph on empty frames; ends it, whatever happens."""
    from graph_runs import start_bringup

    with tempfile.TemporaryDirectory() as folder:
        scenario = Path(folder) / 'empty.yaml'
        scenario.write_text(SCENARIO.format(side=side, frames=frames), encoding='utf-8')
        with start_bringup(
                Path(folder) / 'run', *SDT, '--scenario', str(scenario), *arguments,
                domain_id=DOMAIN) as run:
            yield run


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
