# SPDX-License-Identifier: Apache-2.0
"""
Compare the tracker with Stone Soup's on the same detections of one object that comes and goes.

Stone Soup estimates no existence probability: its tracks count as confirmed from their n-th frame
with a detection, for several n, and are deleted after five frames without one.  For each n our
tracker is confirmed at the existence probability with which it has at most as many false tracks.

Where several tracks hit an object, the error is that of the oldest, because the nearest of many
would be near by chance.  GOSPA has cutoff 5 m and order 2.  A second comparison runs the particle
filters alone, on one track that neither deletes.
"""

from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import replace
from pathlib import Path
import time
from typing import Any

from lowsnr_common.core.motion import POS
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_eval.scoring import metrics
from lowsnr_sensor.scenario import load_scenario
from lowsnr_track.detection_model import DetectionModel
from lowsnr_track.pda_mmpf import PdaMmpf
import numpy as np
from scipy.special import expit
from stonesoup.tracker.particle import SingleTargetExpectedLikelihoodParticleFilter
from stonesoup_trackers import Frames
from stonesoup_trackers import joint_pda
from stonesoup_trackers import mean_of
from stonesoup_trackers import particle_filter
from stonesoup_trackers import updates
import tracker_model as model
from tracker_scores import GATE_M

SCENARIO = Path(__file__).resolve().parents[1] / 'config' / 'scenarios' / 'random.yaml'
CLUTTER = 0.5 / 400  # half a false detection a frame
CONFIRMED_AFTER = (2, 3, 4, 5)
PARTICLES = 10_000  # of both particle filters
CUTOFF_M = Evaluation().gospa_cutoff_m
# Existence probabilities at which our tracks are confirmed, the lowest first.
CONFIRM = expit(np.linspace(-5.0, 15.0, 201))
TRACKER = PdaMmpf(rows=20, cols=20, detection=DetectionModel(
    clutter_density=CLUTTER, clutter_memory_frames=0, use_scores=False))


@dataclass(frozen=True)
class Shown:
    """
    A track of a frame.

    ``evidence`` is its existence probability, or the number of its detections; ``age`` is larger
    for a younger one.
    """

    name: str
    age: int
    evidence: float
    position: np.ndarray


@dataclass(frozen=True)
class Run:
    """Truth (None for absent), tracks of ours and of Stone Soup, and CPU times (K, 2) [ms]."""

    truth: list[np.ndarray | None]
    ours: list[list[Shown]]
    theirs: list[list[Shown]]
    times_ms: np.ndarray


def compare(
    runs: int, seed: int, particles: int,
    make: Callable[[PdaMmpf, list[np.ndarray], np.random.Generator], Frames],
) -> dict[str, Any]:
    """Run both on the same detections, frame by frame in turn."""
    tracker = replace(TRACKER, particles=particles)
    raced = [race(tracker, make, np.random.default_rng([seed, 4, run])) for run in range(runs)]
    times = np.concatenate([run.times_ms for run in raced])
    ours = [scores(raced, 'ours', confirm, 0.3) for confirm in CONFIRM]
    rng = np.random.default_rng([seed, 10])
    pairs = {}
    for count in CONFIRMED_AFTER:
        theirs = scores(raced, 'theirs', count, count)
        mine = next(one for one in ours if one['false'].sum() <= theirs['false'].sum())
        pairs[str(count)] = paired(mine, theirs, rng)
    middle = np.median(times, axis=0)
    return {
        'runs': runs, 'particles': particles, 'confirmed_after': pairs,
        'median_ms': middle.tolist(), 'median_ratio': float(middle[1] / middle[0])}


def race(
    tracker: PdaMmpf,
    make: Callable[[PdaMmpf, list[np.ndarray], np.random.Generator], Frames],
    rng: np.random.Generator,
) -> Run:
    """Run both on one scene, frame by frame in turn."""
    np.random.seed(rng.integers(2**31))  # noqa: NPY002  (Stone Soup draws from it)
    truth, frames = scene(tracker, rng)
    other, memory = iter(make(tracker, frames, rng)), tracker.init()
    run = Run(truth, [], [], np.zeros((len(frames), 2)))
    birth: dict[str, int] = {}
    for k, detections in enumerate(frames):
        start = time.process_time()
        records = [model.as_record(z) for z in detections]
        memory, output = tracker.step(memory, records, k + 1.0, rng)
        middle = time.process_time()
        _, tracks = next(other)
        run.times_ms[k] = 1e3 * (middle - start), 1e3 * (time.process_time() - middle)
        run.ours.append([
            Shown(item.id, int(item.id), item.score, item.state[POS])
            for item in output.confirmed + output.tentative])
        run.theirs.append([
            Shown(track.id, birth.setdefault(track.id, len(birth)), updates(track),
                  mean_of(track)[POS]) for track in tracks])
    return run


def scores(
    runs: Sequence[Run], whose: str, confirm: float, release: float,
) -> dict[str, np.ndarray]:
    """
    Score the tracks that are confirmed by this evidence, and released below another.

    Returns
    -------
    dict of (runs, frames) ndarray
        ``away``, distance of the oldest track that hits, NaN for none; number of ``false`` tracks;
        whether the object is ``present``; ``gospa`` [m].

    """
    found = [list(_score(run, getattr(run, whose), confirm, min(release, confirm)))
             for run in runs]
    names = ('away', 'false', 'present', 'gospa')
    return dict(zip(names, np.moveaxis(np.array(found, dtype=float), -1, 0)))


def _score(
    run: Run, tracks: list[list[Shown]], confirm: float, release: float,
) -> Iterator[tuple[float, int, bool, float]]:
    confirmed: set[str] = set()
    for position, frame in zip(run.truth, tracks):
        shown = sorted(
            (item for item in frame
             if item.evidence >= (release if item.name in confirmed else confirm)),
            key=lambda item: item.age)
        confirmed = {item.name for item in shown}
        places = np.reshape([item.position for item in shown], (-1, 2))
        objects = np.reshape([] if position is None else position, (-1, 2))
        distance = metrics.distances(objects, places)
        hits = distance[distance <= GATE_M]
        yield (hits[0] if hits.size else np.nan, len(shown) - bool(hits.size),
               position is not None, metrics.gospa(distance, CUTOFF_M))


def paired(
    ours: dict[str, np.ndarray], theirs: dict[str, np.ndarray], rng: np.random.Generator,
) -> dict[str, Any]:
    """Return figures of both, and ours against theirs with its 95 % interval over runs."""
    both = np.isfinite(ours['away']) & np.isfinite(theirs['away'])
    draw = rng.integers(len(both), size=(1000, len(both)))
    squared = [np.where(both, one['away'], 0.0)**2 for one in (ours, theirs)]
    present = ours['present'].sum(axis=1)
    hits = [np.isfinite(one['away']).sum(axis=1) for one in (ours, theirs)]
    gospa = [one['gospa'].sum(axis=1) for one in (ours, theirs)]

    def bounds(figure: Callable[[Any], np.ndarray]) -> tuple[float, float, float]:
        drawn = figure(lambda each: each[draw].sum(axis=1))
        return (float(figure(np.sum)), *np.quantile(drawn, [0.025, 0.975]).tolist())

    return {
        'pd': [float(each.sum() / present.sum()) for each in hits],
        'false': [float(one['false'].mean()) for one in (ours, theirs)],
        'gospa_m': [float(one['gospa'].mean()) for one in (ours, theirs)],
        'rmse_m': [float(np.sqrt(each[both].mean())) for each in squared],
        'pd_gain': bounds(lambda add: add(hits[0] - hits[1]) / add(present)),
        'gospa_ratio': bounds(lambda add: add(gospa[0]) / add(gospa[1])),
        'rmse_ratio': bounds(lambda add: np.sqrt(
            add(squared[0].sum(axis=1)) / add(squared[1].sum(axis=1))))}


def against_particle_filter(runs: int, seed: int) -> dict[str, Any]:
    """Compare with the PDA and its multi-model particle filter, with as many particles."""
    return compare(runs, seed, PARTICLES, particle_filter)


def against_joint_pda(runs: int, seed: int) -> dict[str, Any]:
    """Compare with the JPDA and its Kalman filters, with our default of particles."""
    return compare(runs, seed, TRACKER.particles, lambda *scene: joint_pda(*scene[:2]))


def compare_alone(runs: int, seed: int) -> dict[str, Any]:
    """Run both particle filters on one track, born from the object's first detection."""
    tracker = replace(model.MODEL, particles=PARTICLES)
    ours, theirs = [], []
    for run in range(runs):
        rng = np.random.default_rng([seed, 8, run])
        np.random.seed(rng.integers(2**31))  # noqa: NPY002
        states, frames = model.simulate(tracker, 20, True, rng)
        ours.append(model.follow(tracker, states, frames, True, rng).error)
        other = particle_filter(
            tracker, frames, rng, SingleTargetExpectedLikelihoodParticleFilter, 10**6)
        means = [mean_of(next(iter(tracks))) for _, tracks in other]
        theirs.append(states - np.array(means))
    found: dict[str, Any] = {'runs': runs, 'particles': PARTICLES}
    for name, axes in (('position', [0, 2]), ('velocity', [1, 3])):
        squared = np.array([[np.sum(error[:, axes]**2) for error in part]
                            for part in (ours, theirs)])
        rng = np.random.default_rng([seed, 9])
        draws = squared[:, rng.integers(runs, size=(1000, runs))].sum(axis=-1)
        low, high = np.quantile(np.sqrt(draws[0] / draws[1]), [0.025, 0.975])
        rmse = np.sqrt(squared.mean(axis=1) / len(states))
        found[name] = {
            'ours': float(rmse[0]), 'stone_soup': float(rmse[1]),
            'ratio': (float(rmse[0] / rmse[1]), float(low), float(high))}
    return found


def scene(
    tracker: PdaMmpf, rng: np.random.Generator,
) -> tuple[list[np.ndarray | None], list[np.ndarray]]:
    """Return position (or None) and detections (m, 2) of each frame of a random object."""
    truth: list[np.ndarray | None] = []
    frames = []
    for present in load_scenario(SCENARIO).truth(1.0, 1.0, rng):
        position = present[0].state[POS] if present else None
        found = rng.uniform(-0.5, 19.5, (rng.poisson(400 * CLUTTER), 2))
        if position is not None and rng.random() < tracker.detection.probability:
            seen = position + np.sqrt(model.VARIANCE) * rng.standard_normal(2)
            found = np.concatenate([found, seen[None]])
        truth.append(position)
        frames.append(np.clip(found, -0.5, 19.499))
    return truth, frames
