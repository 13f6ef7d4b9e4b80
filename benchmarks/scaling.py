# SPDX-License-Identifier: Apache-2.0
"""
Measure how time and memory grow with frames, objects and particles, and extrapolate to more cores.

A row is the median processor time of one thread a frame and the memory that its process took, at
the smallest and the largest size; the slope is that of log time over log size by least squares.
The memory holds the eight frames that are taken in turn, and not the interpreter's.
The times on more cores are a calculation, not a measurement: Amdahl's law with the measured share
of the time that bands of rows do not share.  It leaves out that cores share the memory.
"""

import argparse
from collections.abc import Callable
import json
import multiprocessing
import os
from pathlib import Path
import resource
import sys
import time
from typing import Any
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / 'scripts'), str(ROOT / 'test'), str(ROOT / 'benchmarks')]

import _environment  # noqa: E402

CORES = (1, 2, 8, 64)
SIDES = (256, 512, 1024, 2048, 4096)
# Frames that are not counted; more follow where they are short.
SETTLED, LEAST_FRAMES, LEAST_S = 6, 7, 0.3
HEADER = (
    '| what | size | ms a frame | slope | MiB |\n|---|---|---|---|---|',
    '\n| calculated, ms a frame | serial | ' + ' | '.join(f'{n} cores' for n in CORES) + ' |\n'
    '|---|---|' + '---|' * len(CORES))


class Row(NamedTuple):
    """What is measured: ``make`` returns the work of a frame at one of the ``sizes``."""

    what: str
    unit: str
    sizes: tuple[int, ...]
    make: Callable[[int], Callable[[], Any]]


class Cost(NamedTuple):
    """Median processor time of a frame [s], memory [MiB], share of the time outside of bands."""

    seconds: float
    memory: float
    serial: float


def main() -> int:
    """Measure, and print the two tables."""
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False,
        epilog='example: python benchmarks/scaling.py --only SDT')
    parser.add_argument('--only', default='', help='rows whose name contains this')
    parser.add_argument(
        '--largest', type=int, default=SIDES[-1], choices=SIDES, help='rows and columns (4096)')
    parser.add_argument('--out', type=Path, help='write the costs to this JSON file')
    options = parser.parse_args()
    os.environ |= {'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'}
    _environment.ensure(dev=True)
    found, every = {}, rows(options.largest)
    some = [row for row in every if options.only in row.what]
    if not some:
        parser.error(f'--only {options.only}: no row has this in its name; '
                     f'there are {", ".join(row.what for row in every)}')
    print(HEADER[0])
    for row in some:
        found[row.what] = costs = [measured(row, size) for size in row.sizes]
        print(line(row, costs), flush=True)
    print(HEADER[1])
    for what, costs in found.items():
        if costs[-1].serial < 1.0:
            print(f'| {what} | {costs[-1].serial:.0%} | ' + ' | '.join(
                f'{1e3 * on_cores(costs[-1], cores):.3g}' for cores in CORES) + ' |')
    if options.out:
        options.out.write_text(json.dumps(found, indent=1), encoding='utf-8')
    return 0


def rows(largest: int) -> list[Row]:
    """Return all rows."""
    from dataclasses import replace

    import kernels
    from lowsnr_detect.detectors.bernoulli import Bernoulli
    from lowsnr_detect.detectors.cusum import CUSUM
    from lowsnr_detect.detectors.hmm import HMM
    from lowsnr_detect.detectors.sdt import SDT
    from lowsnr_detect.detectors.tbd2 import MMTBD2
    from lowsnr_detect.detectors.velocity_bank import VelocityBank
    import numba  # noqa: F401  (here, so that its memory counts for no row)
    sides = tuple(side for side in SIDES if side <= largest)

    def of_cells(what: str, detector: Any, some: tuple[int, ...]) -> Row:
        return Row(what, 'cells a side', some, lambda side: kernels.stepping(detector, side))

    def of_particles(count: int) -> Callable[[], Any]:
        return kernels.stepping(
            replace(MMTBD2(), particles=count, birth_particles=count // 3), 20)

    never = kernels.NEVER
    return [
        Row('conditioner', 'pixels a side', sides, lambda side: kernels.conditioning(side, 0)),
        of_cells('SDT s_m 5', SDT(threshold=never), sides),
        of_cells('CUSUM', CUSUM(threshold=never), sides[:4]),
        of_cells('velocity bank', VelocityBank(threshold=never), sides[:3]),
        of_cells('HMM order 1', HMM(order=1, threshold=never), sides[:3]),
        of_cells('Bernoulli order 1', Bernoulli(order=1), sides[:3]),
        Row('MMTBD2', 'particles', (1_000, 3_000, 10_000, 30_000, 100_000), of_particles),
        Row('tracker, 500 particles a track', 'objects', (10, 30, 100, 300), tracked)]


def tracked(objects: int) -> Callable[[], Any]:
    """Return the work of the tracker's next frame of many objects without false detections."""
    import itertools

    from lowsnr_common.core.records import Estimate
    from lowsnr_track.pda_mmpf import PdaMmpf
    import many_scene
    import numpy as np
    rng, side, frame = np.random.default_rng(0), 1024, itertools.count()
    tracker = many_scene.sized(PdaMmpf(), side, 500, objects)
    places, cov, memory = rng.uniform(0.0, side, (objects, 2)), np.full((4, 4), np.nan), [
        tracker.init()]
    cov[np.ix_([0, 2], [0, 2])] = 0.4 * np.eye(2)

    def work() -> None:
        seen = places + rng.normal(0.0, 0.6, places.shape)
        found = [Estimate(np.array([x, np.nan, y, np.nan]), cov, 0.9, '') for x, y in seen]
        memory[0] = tracker.step(memory[0], found, float(next(frame)), rng)[0]

    return work


def measured(row: Row, size: int) -> Cost:
    """Return what a frame costs, in a process of its own."""
    context = multiprocessing.get_context('fork')
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=lambda: there.send(cost(row.make, size)))
    process.start()
    there.close()
    try:
        found: Cost = here.recv()
    finally:
        process.join()
    return found


def cost(make: Callable[[int], Callable[[], Any]], size: int) -> Cost:
    """Return what a frame costs in this process."""
    import numpy as np
    before, shared = memory_mib(), [0.0]
    watch_bands(shared)
    work = make(size)
    for _ in range(SETTLED):
        work()
    times: list[float] = []
    shared[0] = 0.0
    while len(times) < LEAST_FRAMES or (sum(times) < LEAST_S and len(times) < 500):
        start = time.thread_time()
        work()
        times.append(time.thread_time() - start)
    return Cost(
        float(np.median(times)), memory_mib() - before, 1.0 - shared[0] / sum(times))


def watch_bands(shared: list[float]) -> None:
    """Add the processor time that is spent in bands of rows to ``shared``."""
    from lowsnr_common.images import bands
    original = bands.in_bands

    def timed(*given: Any, **more: Any) -> None:
        start = time.thread_time()
        original(*given, **more)
        shared[0] += time.thread_time() - start

    for module in list(sys.modules.values()):
        if getattr(module, 'in_bands', None) is original:
            module.in_bands = timed  # type: ignore[attr-defined]


def memory_mib() -> float:
    """Return the most memory that this process has had [MiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def on_cores(spent: Cost, cores: int) -> float:
    """Return the time of a frame on some cores by Amdahl's law [s]."""
    return spent.seconds * (spent.serial + (1.0 - spent.serial) / cores)


def line(row: Row, costs: list[Cost]) -> str:
    """Return the row of the table in Markdown."""
    import numpy as np
    slope = float('nan')
    if len(costs) > 1:
        slope = np.polyfit(np.log(row.sizes), np.log([each.seconds for each in costs]), 1)[0]
    sizes, times, memory = (
        f'{values[0]:{kind}} to {values[-1]:{kind}}' for values, kind in (
            (row.sizes, ','), ([1e3 * each.seconds for each in costs], '.3g'),
            ([each.memory for each in costs], '.0f')))
    return f'| {row.what} | {sizes} {row.unit} | {times} | {slope:.2f} | {memory} |'


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
