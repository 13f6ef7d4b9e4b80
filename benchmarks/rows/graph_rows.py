# SPDX-License-Identifier: Apache-2.0
"""Rows of the whole graph, SDT with s_m = 5: start, recovery, latency, rate and memory."""

from collections.abc import Iterator
import contextlib
import csv
import functools
from pathlib import Path
import signal
import statistics
import tempfile
import time
from typing import Any

from graph_runs import own_domain
from graph_runs import start_bringup
from rows.row import Figure
from rows.row import Measurement
from rows.row import need_receive_buffer

SCENARIO = """
frames: {frames}
rows: {side}
cols: {side}
snr_db: 9.0
objects: []
"""
SDT = ('--detector', 'sdt', '--set', 'sdt.max_iterations=5')
SIDE, RATE_HZ, SECONDS = 1024, 30, 60
NODES = ('detector_node', 'tracker_node')
START_S, BACK_S, FASTEST_HZ, LATEST_MS = 2.0, 2.0, 100.0, 60.0
# Frames after which memory is looked at, and how much may have come to it [MiB].
EARLY, LATE, FLAT_MIB = 10_000, 100_000, 4.0
INTERRUPTED = 130


def measurements() -> list[Measurement]:
    """Return the rows."""
    size, paced = f'{SIDE} x {SIDE} float32', f'{RATE_HZ} a second for {SECONDS} s'
    return [
        Measurement('start, warm: command to first frame scored', f'{START_S:g} s', start),
        *(Measurement(f'{node} killed: back after, longest of 3', f'{BACK_S:g} s',
                      functools.partial(back, node)) for node in NODES),
        Measurement(f'{size}, lockstep', f'{FASTEST_HZ:g} a second', lockstep),
        Measurement(f'{size}, {paced}: unanswered', '0', unanswered),
        Measurement(f'{size}, {paced}: frame to track, 99 %', f'{LATEST_MS:g} ms', large),
        Measurement(f'memory, from {EARLY} to {LATE} frames',
                    f'{FLAT_MIB:g} MiB more a node', memory)]


def start() -> Figure:
    """Time from the command to the first scored frame, and of processors, after a first start."""
    times, spent = [], []
    for _ in range(4):
        began = time.monotonic()
        with graph(20, 5, '--lockstep') as run:
            run.wait_for_rows(1)
            times.append(time.monotonic() - began)
            spent.append(processor_s(run.process.pid))
            done(run)
    median = statistics.median(times[1:])
    return Figure(
        f'{median:.2f} s (median of 3, least {min(times[1:]):.2f} s; of processors '
        f'{statistics.median(spent[1:]):.2f} s)', median <= START_S)


def back(node: str) -> Figure:
    """Time from the death of a node until it is active again."""
    times = recovery()[node]
    return Figure(f'{max(times):.2f} s (median {statistics.median(times):.2f} s)',
                  max(times) <= BACK_S)


@functools.cache
def recovery() -> dict[str, list[float]]:
    """Kill nodes in three runs; return how long each was away [s]."""
    down: dict[str, list[float]] = {node: [] for node in NODES}
    for _ in range(3):
        with graph(20, 40, '--lockstep', '--loop') as run:
            run.wait_for_rows(20)
            for count, (node, times) in enumerate(down.items(), start=1):
                run.kill(node)
                run.wait_for_restarts(count)
                times.append(float(run.restarts()[-1]['down_s']))
                run.wait_for_rows(len(run.rows()) + 20)
            run.process.send_signal(signal.SIGINT)
            done(run, INTERRUPTED)
    return down


def lockstep() -> Figure:
    """Count the frames a second where each waits for the answer to the one before."""
    need_receive_buffer(4 * SIDE**2)
    frames = RATE_HZ * SECONDS
    seen: list[tuple[float, float]] = []
    with graph(SIDE, frames, '--lockstep') as run:
        while run.process.poll() is None:
            scored = len(run.rows()) / 2
            if 10 <= scored < frames:
                seen.append((time.monotonic(), scored))
            time.sleep(0.5)
        done(run)
    (began, first), (ended, last) = seen[0], seen[-1]
    rate = (last - first) / (ended - began)
    return Figure(f'{rate:.1f} a second', rate >= FASTEST_HZ)


def unanswered() -> Figure:
    """Count the frames of a paced run that were not scored."""
    frames = paced()[0]
    lost = frames['expected'] - frames['scored']
    return Figure(f'{lost} of {frames["expected"]}', lost == 0)


def large() -> Figure:
    """Time from frame to track in a paced run, both as they come to the evaluator."""
    spent = paced()[1]
    late = statistics.quantiles(spent, n=100)[-1]
    return Figure(f'{late:.1f} ms (median {statistics.median(spent):.1f} ms)', late <= LATEST_MS)


@functools.cache
def paced() -> tuple[dict[str, int], list[float]]:
    """Run at a fixed rate; return the counts of frames, and the times from frame to track [ms]."""
    need_receive_buffer(4 * SIDE**2)
    with graph(SIDE, RATE_HZ * SECONDS, '--rate', str(RATE_HZ)) as run:
        done(run)
        return run.summary()['frames'], latencies(run)


def memory() -> Figure:
    """Compare the resident memory of each node early and late in a long run."""
    import psutil

    with graph(20, LATE, '--lockstep') as run:
        early: dict[str, float] = {}
        late: dict[str, float] = {}
        while run.process.poll() is None:
            now: dict[str, float] = {}
            with contextlib.suppress(psutil.Error):  # a node has ended
                now = {name: psutil.Process(pid).memory_info().rss / 2**20
                       for name, pid in run.nodes().items()}
            frames = len(run.rows()) / 2
            if now and frames > EARLY and not early:
                early = now
            if now and frames < 0.98 * LATE:
                late = now
            time.sleep(2.0)
        done(run)
    shown = ', '.join(f'{name.removesuffix("_node")} {early[name]:.1f} and {late[name]:.1f}'
                      for name in early)
    return Figure(f'{shown} MiB', all(late[name] <= early[name] + FLAT_MIB for name in early))


def latencies(run: Any) -> list[float]:
    """Return the time from frame to track of every frame [ms], after the first ten."""
    with (run.results / 'latency.csv').open(encoding='utf-8', newline='') as file:
        return [float(row['latency_ms']) for row in csv.DictReader(file)][10:]


def processor_s(pid: int) -> float:
    """Return the processor time of a process and those below it, ended ones left out [s]."""
    import psutil

    process, spent = psutil.Process(pid), 0.0
    for each in (process, *process.children(recursive=True)):
        with contextlib.suppress(psutil.NoSuchProcess):
            spent += sum(each.cpu_times()[:2])
    return spent


def done(run: Any, expected: int = 0) -> None:
    """Wait for the end of a run that must end with a code."""
    code, _, err = run.finish(within_s=3600.0)
    if code != expected:
        raise RuntimeError(f'bringup.py ended with {code}: {err}')


@contextlib.contextmanager
def graph(side: int, frames: int, *arguments: str) -> Iterator[Any]:
    """Start the graph on empty frames; ends it, whatever happens."""
    with tempfile.TemporaryDirectory() as folder:
        scenario = Path(folder) / 'empty.yaml'
        scenario.write_text(SCENARIO.format(side=side, frames=frames), encoding='utf-8')
        with start_bringup(
                Path(folder) / 'run', *SDT, '--scenario', str(scenario), *arguments,
                domain_id=own_domain()) as run:
            yield run
