"""
Detectors and particle filters against references that are timed beside them.

``python benchmarks/table.py`` writes them as a table of ratios; with pytest-benchmark each is run
by ``pytest benchmarks/kernels.py``.
"""

from collections.abc import Callable
from collections.abc import Iterator
from dataclasses import dataclass
from dataclasses import replace
import itertools
from pathlib import Path
import statistics
import sys
import time
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / 'test'), *(str(path) for path in (ROOT / 'src').glob('lowsnr_*'))]

from detect import numpy_detectors  # noqa: E402
from lowsnr_common.core.motion import MotionModes  # noqa: E402
from lowsnr_common.core.records import Estimate  # noqa: E402
from lowsnr_common.ros.memory import keep_freed_memory  # noqa: E402
from lowsnr_detect.detectors.cusum import CUSUM  # noqa: E402
from lowsnr_detect.detectors.hmm import HMM  # noqa: E402
from lowsnr_detect.detectors.sdt import SDT  # noqa: E402
from lowsnr_detect.detectors.tbd2 import MMTBD2  # noqa: E402
from lowsnr_detect.parts.moves import move_model  # noqa: E402
from lowsnr_detect.parts.wald_bounds import wald_bounds  # noqa: E402
from lowsnr_track.pda_mmpf import PdaMmpf  # noqa: E402
from lowsnr_track.track_management import TrackLife  # noqa: E402
import numpy as np  # noqa: E402
import pytest  # noqa: E402
from sensor import numpy_particles  # noqa: E402

SIDES = (20, 64, 256, 1024, 2048)
DEPTHS = (1, 2, 3, 5, 8, 16)
PARTICLES = (500, 2_000, 10_000, 30_000, 100_000)
SEED = 0
# Above whatever the same few frames of noise, over and over, reach: declarations are not timed.
NEVER = 60.0
_LEAST_S = 2e-3

# As every node does.
keep_freed_memory()
Work = Callable[[], Any]


@dataclass(frozen=True)
class Case:
    """
    What is timed, and beside what.

    ``make`` returns subject and reference; ``count`` is how many ``unit`` the subject works on,
    ``goal`` the largest, or for ``faster`` the smallest, ratio wanted, ``goal_ns`` that of the
    nanoseconds a unit.
    """

    what: str
    size: str
    reference: str
    make: Callable[[], tuple[Work, Work]]
    count: int
    unit: str
    goal: float | None = None
    goal_ns: float | None = None
    faster: bool = False


@dataclass(frozen=True)
class Timing:
    """Median times of the processor [s]."""

    subject: float
    reference: float


def timed(case: Case, least_s: float, rounds: int) -> Timing:
    """Time subject and reference in turn, so that both meet the same disturbances."""
    works = case.make()
    repeats = [_repeats(work) for work in works]
    spent: tuple[list[float], list[float]] = [], []
    until = time.monotonic() + least_s
    while len(spent[0]) < rounds or (time.monotonic() < until and len(spent[0]) < 100 * rounds):
        for work, count, times in zip(works, repeats, spent):
            start = time.thread_time()
            for _ in range(count):
                work()
            times.append((time.thread_time() - start) / count)
        if time.monotonic() > until + 60.0:
            break
    return Timing(*(statistics.median(times) for times in spent))


def _repeats(work: Work) -> int:
    """Return how often a work is done in a row, so that a clock's tick is small to it."""
    work()
    start = time.thread_time()
    work()
    return max(1, int(_LEAST_S / max(time.thread_time() - start, 1e-6)))


def frames_of(side: int, kind: type = np.float32) -> Iterator[np.ndarray]:
    """Yield frames of noise, another one every time as far as memory goes."""
    rng = np.random.default_rng(SEED)
    some = [rng.standard_normal((side, side)).astype(kind) for _ in range(8 if side > 500 else 40)]
    return itertools.cycle(some)


def stepping(detector: Any, side: int, kind: type = np.float32) -> Work:
    """Return the work of a detector's next frame."""
    frames, rng = frames_of(side, kind), np.random.default_rng(SEED)
    memory = [detector.init((side, side))]

    def work() -> None:
        memory[0] = detector.step(memory[0], next(frames), rng)[0]

    for _ in range(3):
        work()
    return work


def hmm(order: int, side: int) -> Work:
    """Return the work of the grid filter's next frame."""
    return stepping(HMM(order=order, threshold=NEVER), side)


def copy(planes: int, side: int, kind: type = np.float32) -> Work:
    """Return the work of copying planes."""
    source = np.ones((planes, side, side), dtype=kind)
    target = np.ones_like(source)
    return lambda: np.copyto(target, source)


def numpy_sdt(depths: int, side: int) -> Work:
    """Return the work of SDT's next frame, in plain NumPy and float64."""
    frames, sensor, state = frames_of(side, np.float64), SDT().sensor, [
        np.full((depths - 1, side, side), -np.inf)]

    def work() -> None:
        paths = numpy_detectors.extend_paths(
            state[0], sensor.log_likelihood_ratio(next(frames)), 1, False,
            wald_bounds(0.01, 1e-4)[0], 100.0)
        state[0] = paths[:-1]
        np.flatnonzero(paths[-1] > NEVER)

    return work


def enumeration(depths: int, side: int) -> Work:
    """Return the work of extending, one by one, all paths from each cell by a frame."""
    frame = np.random.default_rng(SEED).standard_normal((side, side))
    padded = np.full((side + 2 * depths,) * 2, -np.inf)
    padded[depths:-depths, depths:-depths] = frame
    plane, wide = padded.ravel(), side + 2 * depths
    steps = np.add.outer(wide * np.arange(-1, 2), np.arange(-1, 2)).ravel()

    def work() -> None:
        for row, col in np.ndindex(side, side):
            cells = np.array([(row + depths) * wide + col + depths])
            sums = plane[cells]
            for _ in range(depths - 1):
                cells = np.add.outer(cells, steps).ravel()
                sums = np.repeat(sums, 9) + plane[cells]
                np.flatnonzero(sums > NEVER)

    return work


def numpy_hmm(order: int, side: int) -> Work:
    """Return the work of the grid filter's next frame, in plain NumPy."""
    detector = HMM(order=order)
    model, frames = move_model(detector.motion, detector.sensor, order), frames_of(side)
    shape = (*model.history.shape, side, side)
    belief = [np.full(shape, 1.0 / np.prod(shape))]

    def work() -> None:
        ratio = detector.sensor.log_likelihood_ratio(next(frames))
        weight = np.exp(ratio - ratio.max())
        moved = numpy_detectors.move_belief(model, belief[0])
        given = model.history[..., None, None] / side**2 * (0.02 * weight)
        given += moved * (0.98 * weight)
        belief[0] = given / given.sum()
        moved.sum()

    return work


def numpy_cloud(count: int, side: int) -> Work:
    """Return the work of moving, weighing and resampling a cloud, in plain NumPy."""
    motion, frames, rng = MotionModes(), frames_of(side), np.random.default_rng(SEED)
    sensor = MMTBD2().sensor
    cloud = [rng.uniform(0.0, side - 1.0, (count, 4)), rng.integers(3, size=count)]

    def work() -> None:
        modes = numpy_particles.switch(motion, cloud[1], 1.0, rng)
        states = numpy_particles.move(motion, cloud[0], modes, 1.0, rng)
        log_weights = numpy_particles.state_log_ratio(sensor, next(frames), states)
        log_weights[0] = 0.0
        chosen = numpy_particles.systematic_resample(log_weights, count, rng)
        cloud[:] = np.take_along_axis(states, chosen[:, None], axis=0), modes[chosen]

    return work


def tracking(count: int, detections: int, births: bool = False) -> Work:
    """Return the work of a tracker's next frame: one track, with detections in its gate."""
    first = PdaMmpf(particles=count, life=TrackLife(max_tracks=1))
    # With births there is a second cloud in every frame, which is merged or dropped at its end.
    later = first if births else replace(first, life=TrackLife(max_tracks=1, birth_density=1e-12))
    rng, memory = np.random.default_rng(SEED), [first.init()]
    frame, cov = itertools.count(), np.full((4, 4), np.nan)
    cov[np.ix_([0, 2], [0, 2])] = 0.4 * np.eye(2)

    def work(tracker: PdaMmpf = later, number: int = detections) -> None:
        k = next(frame)
        places = np.array([100.0 + 0.3 * k, 100.0]) + rng.normal(
            0.0, [[0.3]] + [[1.5]] * (number - 1), (number, 2))
        found = [Estimate(np.array([x, np.nan, y, np.nan]), cov, 0.6, '') for x, y in places]
        memory[0] = tracker.step(memory[0], found, float(k), rng)[0]
        assert len(memory[0].tracks) == 1

    for _ in range(6):
        work(first, 1)
    return work


def cases() -> list[Case]:
    """Return everything that is timed."""
    found = []
    for side in SIDES:
        size, cells = f'{side} x {side}', side**2
        found += [
            Case('SDT s_m=5', size, 'copy of 5 float32 planes',
                 lambda side=side: (stepping(SDT(threshold=NEVER), side), copy(5, side)),
                 5 * cells, 'cell and plane', 2.0 if side == 1024 else None),
            Case('SDT s_m=5', size, 'NumPy',
                 lambda side=side: (stepping(SDT(threshold=NEVER), side), numpy_sdt(5, side)),
                 5 * cells, 'cell and plane'),
            Case('CUSUM', size, 'copy of 2 float32 planes',
                 lambda side=side: (stepping(CUSUM(threshold=NEVER), side), copy(2, side)),
                 cells, 'cell'),
            Case('HMM order 0', size, 'NumPy',
                 lambda side=side: (hmm(0, side), numpy_hmm(0, side)),
                 cells, 'cell', goal_ns=5.0 if side == 1024 else None)]
    return [*found, *_other_cases()]


def _other_cases() -> list[Case]:
    found = [
        Case('SDT s_m=6', '20 x 20', 'path enumeration',
             lambda: (stepping(SDT(threshold=NEVER, max_iterations=6), 20), enumeration(6, 20)),
             6 * 400, 'cell and plane', 1e-4, faster=True),
        *(Case('HMM order 2', f'{side} x {side}', 'NumPy',
               lambda side=side: (hmm(2, side), numpy_hmm(2, side)),
               side**2, 'cell', goal_ns=1000.0) for side in (20, 256)),
        Case('HMM order 2', '1024 x 1024', 'copy of 81 float64 planes',
             lambda: (hmm(2, 1024), copy(81, 1024, np.float64)),
             1024**2, 'cell', goal_ns=1000.0)]
    found += [
        Case(f'SDT s_m={depths}', '256 x 256', f'copy of {depths} float32 planes',
             lambda depths=depths: (
                 stepping(SDT(threshold=NEVER, max_iterations=depths), 256), copy(depths, 256)),
             depths * 256**2, 'cell and plane') for depths in DEPTHS]
    for count in PARTICLES:
        detector = replace(MMTBD2(), particles=count, birth_particles=count // 3)
        goals = (80.0, 200.0) if count >= 10_000 else (None, None)
        found += [
            Case('MMTBD2', f'{count} + {count // 3}', 'NumPy: move, weigh, resample',
                 lambda detector=detector, count=count: (
                     stepping(detector, 20), numpy_cloud(count, 20)),
                 count + count // 3, 'particle', goal_ns=goals[0]),
            Case('PDA-MMPF, 7 detections', f'{count}', 'NumPy: move, weigh, resample',
                 lambda count=count: (tracking(count, 7), numpy_cloud(count, 20)),
                 count, 'particle', goal_ns=goals[1]),
            Case('PDA-MMPF, 7 detections and a birth', f'{count}',
                 'NumPy: move, weigh, resample',
                 lambda count=count: (tracking(count, 7, births=True), numpy_cloud(count, 20)),
                 count, 'particle', goal_ns=goals[1])]
    return found


@pytest.mark.parametrize('case', cases(), ids=lambda case: f'{case.what}, {case.size}')
def test_speed(benchmark: Any, case: Case) -> None:
    """Time a case; what it is compared with stands in ``extra_info``."""
    subject, reference = case.make()
    start = time.thread_time()
    reference()
    benchmark.extra_info['reference'] = case.reference
    benchmark.extra_info['reference_s'] = time.thread_time() - start
    benchmark(subject)
