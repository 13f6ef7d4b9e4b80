# SPDX-License-Identifier: Apache-2.0
"""
Detectors and particle filters, with references that are timed in turn with them.

``python benchmarks/table.py`` writes them as a table of ratios; with pytest-benchmark each is run
by ``pytest benchmarks/kernels.py``.
"""

from collections.abc import Callable
from collections.abc import Iterator
from dataclasses import dataclass
from dataclasses import replace
import importlib
import itertools
from pathlib import Path
import statistics
import sys
import time
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / 'test'), *(str(path) for path in (ROOT / 'src').glob('lowsnr*'))]

from lowsnr_common.core.motion import MotionModes  # noqa: E402
from lowsnr_common.core.process_setup import keep_freed_memory  # noqa: E402
from lowsnr_common.core.records import Estimate  # noqa: E402
from lowsnr_detect.adaptive.adaptive_detector import AdaptiveDetector  # noqa: E402
from lowsnr_detect.detectors.auto import Auto  # noqa: E402
from lowsnr_detect.detectors.cusum import CUSUM  # noqa: E402
from lowsnr_detect.detectors.hmm import forward  # noqa: E402
from lowsnr_detect.detectors.hmm import HMM  # noqa: E402
from lowsnr_detect.detectors.sdt import SDT  # noqa: E402
from lowsnr_detect.detectors.sdt import sequential_test  # noqa: E402
from lowsnr_detect.detectors.tbd2 import MMTBD2  # noqa: E402
from lowsnr_detect.detectors.velocity_bank import VelocityBank  # noqa: E402
from lowsnr_detect.parts.detector import Detector  # noqa: E402
from lowsnr_detect.parts.moves import move_model  # noqa: E402
from lowsnr_detect.parts.wald_bounds import wald_bounds  # noqa: E402
from lowsnr_sensor.conditioning.conditioner import ConditioningSettings  # noqa: E402
from lowsnr_track.pda_mmpf import PdaMmpf  # noqa: E402
from lowsnr_track.track_management import TrackLife  # noqa: E402
import numpy as np  # noqa: E402
import pytest  # noqa: E402
import scipy.ndimage  # noqa: E402

SIDES = (20, 64, 256, 1024, 2048)
DEPTHS = (1, 2, 3, 8, 16)  # 5 at every size
PARTICLES = (500, 2_000, 10_000, 30_000, 100_000)
SEED = 0
# Out of reach of noise, so that declarations are not timed.
NEVER = 60.0
_LEAST_S = 2e-3

# The helpers of the tests are not typed.
numpy_particles: Any = importlib.import_module('common.numpy_particles')
# Every node does so.
keep_freed_memory()
Work = Callable[[], Any]


@dataclass(frozen=True)
class Case:
    """
    A subject and the reference that it is timed with.

    ``make`` returns subject and reference; ``count`` is the number of ``unit`` that the subject
    processes, ``goal`` the largest ratio of the times (with ``faster``, shown as its inverse),
    and ``goal_ns`` the largest time of a unit [ns].
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
    """Median processor times [s]."""

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
    """Return how often a work is repeated, so that its time is well above the clock's tick."""
    work()
    start = time.thread_time()
    work()
    return max(1, int(_LEAST_S / max(time.thread_time() - start, 1e-6)))


def frames_of(side: int, kind: type = np.float32) -> Iterator[np.ndarray]:
    """Yield frames of noise, in a cycle of as many as fit into memory."""
    rng = np.random.default_rng(SEED)
    some: list[np.ndarray] = [
        rng.standard_normal((side, side)).astype(kind) for _ in range(8 if side > 500 else 40)]
    return itertools.cycle(some)


def stepping(detector: Detector, side: int, kind: type = np.float32) -> Work:
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
    source: np.ndarray = np.ones((planes, side, side), dtype=kind)
    target = np.ones_like(source)
    return lambda: np.copyto(target, source)


def numpy_sdt(depths: int, side: int) -> Work:
    """Return the work of SDT's next frame, in plain NumPy and float64."""
    frames, sensor, state = frames_of(side, np.float64), SDT().sensor, [
        np.full((depths - 1, side, side), -np.inf)]
    ln_th = wald_bounds(0.01, 1e-4)[0], 100.0

    def work() -> None:
        state[0], decided = sequential_test(state[0], next(frames), sensor, ln_th, NEVER)
        np.flatnonzero(decided > NEVER)

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
        given = forward(model, belief[0], weight, np.array(0.98), np.array(0.02))
        belief[0] = given / given.sum()

    return work


def numpy_particle_step(count: int, side: int) -> Work:
    """Return the work of moving, weighting and resampling particles, in plain NumPy."""
    motion, frames, rng = MotionModes(), frames_of(side), np.random.default_rng(SEED)
    sensor = MMTBD2().sensor
    particles = [rng.uniform(0.0, side - 1.0, (count, 4)), rng.integers(3, size=count)]

    def work() -> None:
        modes = numpy_particles.switch(motion, particles[1], 1.0, rng)
        states = numpy_particles.move(motion, particles[0], modes, 1.0, rng)
        log_weights = numpy_particles.state_log_ratio(sensor, next(frames), states)
        log_weights[0] = 0.0
        chosen = numpy_particles.systematic_resample(log_weights, count, rng)
        particles[:] = np.take_along_axis(states, chosen[:, None], axis=0), modes[chosen]

    return work


def tracking(count: int, detections: int, births: bool = False) -> Work:
    """Return the work of a tracker's next frame: one track, with detections in its gate."""
    first = PdaMmpf(particles=count, life=TrackLife(max_tracks=1))
    # With births there is a second set of particles in every frame, merged or dropped at its end.
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


def conditioning(side: int, step: int) -> Work:
    """Return the work of conditioning the next frame of a camera that moves, there and back."""
    rng, conditioner = np.random.default_rng(SEED), ConditioningSettings()
    reach = 12 * step
    scene = 200.0 * scipy.ndimage.gaussian_filter(
        rng.standard_normal((side + reach, side + reach), np.float32), 3.0)
    places = [*range(0, reach, step), *range(reach, 0, -step)] if step else [0] * 8
    frames = itertools.cycle([
        scene[place:place + side, place:place + side]
        + rng.standard_normal((side, side), np.float32) for place in places])
    state = [conditioner.init((side, side))]

    def work() -> None:
        state[0], _ = conditioner.step(state[0], next(frames))

    for _ in range(10):
        work()
    return work


def pair(
    subject: Callable[..., Work], given: tuple[Any, ...], reference: Callable[..., Work],
    *its_own: Any,
) -> Callable[[], tuple[Work, Work]]:
    """Return the function that makes a subject and its reference with their arguments."""
    return lambda: (subject(*given), reference(*its_own))


def cases() -> list[Case]:
    """Return all cases."""
    found = []
    for side in SIDES:
        size, cells, sdt = f'{side} x {side}', side**2, (SDT(threshold=NEVER), side)
        found += [
            Case('SDT s_m=5', size, 'copy of 5 float32 planes',
                 pair(stepping, sdt, copy, 5, side),
                 5 * cells, 'cell and plane', 2.0 if side == 1024 else None),
            Case('SDT s_m=5', size, 'NumPy', pair(stepping, sdt, numpy_sdt, 5, side),
                 5 * cells, 'cell and plane'),
            Case('CUSUM', size, 'copy of 2 float32 planes',
                 pair(stepping, (CUSUM(threshold=NEVER), side), copy, 2, side), cells, 'cell'),
            Case('HMM order 0', size, 'NumPy', pair(hmm, (0, side), numpy_hmm, 0, side),
                 cells, 'cell', goal_ns=5.0 if side == 1024 else None)]
    return [*found, *_other_cases()]


def _other_cases() -> list[Case]:
    auto = AdaptiveDetector(Auto(), 0.01, (512, 512))
    found = [
        *(Case(what, '512 x 512', 'copy of 49 int16 planes',
               pair(stepping, (detector, 512), copy, 49, 512, np.int16), 512**2, 'cell', goal)
          for what, detector, goal in (
              ('bank', VelocityBank(threshold=NEVER), 5.0), ('AUTO, adaptive', auto, 10.0))),
        *(Case(f'conditioner, camera {what}', f'{side} x {side}', 'copy of a float32 frame',
               pair(conditioning, (side, step), copy, 1, side), side**2, 'pixel', goal)
          for what, side, step, goal in (
              ('still', 1024, 0, 100.0), ('moving', 1024, 3, 150.0), ('still', 4096, 0, 100.0))),
        Case('SDT s_m=6', '20 x 20', 'path enumeration',
             pair(stepping, (SDT(threshold=NEVER, max_iterations=6), 20), enumeration, 6, 20),
             6 * 400, 'cell and plane', 1e-4, faster=True),
        *(Case('HMM order 2', f'{side} x {side}', 'NumPy',
               pair(hmm, (2, side), numpy_hmm, 2, side), side**2, 'cell', goal_ns=1000.0)
          for side in (20, 256)),
        Case('HMM order 2', '1024 x 1024', 'copy of 81 float64 planes',
             pair(hmm, (2, 1024), copy, 81, 1024, np.float64),
             1024**2, 'cell', goal_ns=1000.0)]
    found += [
        Case(f'SDT s_m={depths}', '256 x 256', f'copy of {depths} float32 planes',
             pair(stepping, (SDT(threshold=NEVER, max_iterations=depths), 256),
                  copy, depths, 256),
             depths * 256**2, 'cell and plane') for depths in DEPTHS]
    for count in PARTICLES:
        detector = replace(MMTBD2(), particles=count, birth_particles=count // 3)
        goals = (80.0, 150.0, 200.0) if count >= 10_000 else (None,) * 3
        numpy = 'NumPy: move, weight, resample'
        found += [
            Case('MMTBD2', f'{count} + {count // 3}', numpy,
                 pair(stepping, (detector, 20), numpy_particle_step, count, 20),
                 count + count // 3, 'particle', goal_ns=goals[0]),
            Case('PDA-MMPF, 7 detections', f'{count}', numpy,
                 pair(tracking, (count, 7), numpy_particle_step, count, 20),
                 count, 'particle', goal_ns=goals[1]),
            Case('PDA-MMPF, 7 detections and a birth', f'{count}', numpy,
                 pair(tracking, (count, 7, True), numpy_particle_step, count, 20),
                 count, 'particle', goal_ns=goals[2])]
    return found


@pytest.mark.parametrize('case', cases(), ids=lambda case: f'{case.what}, {case.size}')
def test_speed(benchmark: Any, case: Case) -> None:
    """Time a case; ``extra_info`` has its reference."""
    subject, reference = case.make()
    start = time.thread_time()
    reference()
    benchmark.extra_info['reference'] = case.reference
    benchmark.extra_info['reference_s'] = time.thread_time() - start
    benchmark(subject)
