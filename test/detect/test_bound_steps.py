# SPDX-License-Identifier: Apache-2.0
"""Grid filters whose states have a destination and a frame of arrival, by matrices."""

from dataclasses import dataclass

from detect import oracles
from lowsnr_common.core.bound_motion import Destinations
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_detect.detectors.hmm import HMM
from lowsnr_detect.detectors.pmf import PMF
from lowsnr_detect.parts.existence import Existence
import numpy as np
import pytest
import scipy

SENSOR = SensorModel(snr_db=4.0, cell_size_m=2.0, frame_period_s=0.5)
EXISTENCE = Existence(birth_prob=0.1, death_prob=0.2, initial_prob=0.3)
MOTION = MotionModes(
    turn_rates_deg_s=(0.0, 120.0), mode_sojourn_s=2.0, acceleration_density=0.4,
    min_speed_mps=1.0, max_speed_mps=4.0)
SHAPE = (2, 3)
TO = Destinations(
    probability=(0.5, 0.3), x_m=(3.5, 0.4), y_m=(1.5, 2.2), std_m=(0.4, 0.9),
    earliest_frame=(3, 4), latest_frame=(4, 4))
ALWAYS = -1e9
CASES = {
    'hmm order 0': (HMM, {'order': 0}), 'hmm order 1': (HMM, {'order': 1}),
    'hmm order 2': (HMM, {'order': 2}),
    'pmf': (PMF, {'resolution': 2, 'headings': 5, 'speeds': 1})}


def build(case, **settings):
    """Return the detector of a case."""
    cls, own = CASES[case]
    base = {'sensor': SENSOR, 'motion': MOTION, 'existence': EXISTENCE, 'destinations': TO,
            'threshold': ALWAYS}
    return cls(**base | own | settings)


def run(detector, frames):
    """Return the declarations of frames (K, ..., rows, cols)."""
    state, answers = detector.init(frames.shape[1:]), []
    for frame in frames:
        state, declared = detector.step(state, frame, None)
        answers.append(declared)
    return answers


@dataclass
class Base:
    """
    States of the base motion.

    ``steps`` has for each class all (class after, rows, columns, probability), ``appears`` its
    probability at a birth; ``resolution`` points a cell and axis.
    """

    steps: list
    appears: np.ndarray
    velocity: np.ndarray
    velocity_cov: np.ndarray
    resolution: int


def base_of(detector):
    """Return the states of a detector."""
    return points_base(detector) if isinstance(detector, PMF) else moves_base(detector)


def moves_base(detector):
    """Return the histories of moves, (dropped, kept) in a row."""
    model, order = detector.steps.model, detector.order
    dropped, kept = model.history.shape
    steps = []
    for old, last in np.ndindex(dropped, kept):
        steps.append([
            ((0, m, last * kept + m)[order], *move, model.kernel[last, m, old])
            for m, move in enumerate(model.moves)])
    return Base(steps, model.history.ravel(), model.velocity.reshape(-1, 2),
                model.velocity_cov.reshape(-1, 2, 2), 1)


def points_base(detector):
    """Return the classes of the point-mass filter; the mode switches before the step."""
    found, steps = detector.transitions, []
    modes = len(found.switch)
    kinds = found.count // modes
    for before in range(found.count):
        own, mode = [], before // kinds
        for target in range(found.count):
            for group in range(*found.first_group[target:target + 2]):
                for entry in range(*found.first_entry[group:group + 2]):
                    then, kind = divmod(found.source[entry], kinds)
                    if kind == before % kinds:
                        own.append((target, *found.step[group],
                                    found.prob[entry] * found.switch[mode, then]))
        steps.append(own)
    return Base(steps, found.appears, found.velocity, found.velocity_cov, detector.resolution)


def all_pairs():
    """Return probability, destination and arrival of all pairs; the first is none."""
    found = [(1.0 - sum(TO.probability), 0, 0)]
    for n, prob in enumerate(TO.probability):
        frames = range(TO.earliest_frame[n], TO.latest_frame[n] + 1)
        found += [(prob / len(frames), n, frame) for frame in frames]
    return found


def places(base):
    """Return column and row of every point in a frame in cells, (rows, cols, 2)."""
    row, col = np.indices([base.resolution * size for size in SHAPE])
    return (np.stack([col, row], axis=-1) + 0.5) / base.resolution - 0.5


def arrives(base, pair, number, kind, row, col):
    """Return L_h of a state."""
    _, n, arrival = pair
    left = (arrival - number) * SENSOR.frame_period_s
    spacing = SENSOR.cell_size_m / base.resolution
    value = 1.0
    for axis, (point, to) in enumerate(((col, TO.x_m[n]), (row, TO.y_m[n]))):
        at = ((point + 0.5) / base.resolution - 0.5) * SENSOR.cell_size_m
        var = (TO.std_m[n]**2 + MOTION.acceleration_density * left**3 / 3.0 + spacing**2 / 12.0
               + left**2 * base.velocity_cov[kind, axis, axis])
        value *= scipy.stats.norm.pdf(
            to, at + left * base.velocity[kind, axis], np.sqrt(var))
    return value


def transition(base, number):
    """Return the matrix of all states (pair, class, row, col) into a frame; absent is the last."""
    rows, cols = (base.resolution * size for size in SHAPE)
    pairs, count = all_pairs(), len(base.steps)
    states = (len(pairs), count, rows, cols)
    total = int(np.prod(states))
    matrix = np.zeros((total + 1, total + 1))
    for h, pair in enumerate(pairs):
        for kind, row, col in np.ndindex(count, rows, cols):
            prob = np.array([
                step[3] * (arrives(base, pair, number, step[0], row + step[1], col + step[2])
                           if pair[2] >= number else 1.0) for step in base.steps[kind]])
            source = np.ravel_multi_index((h, kind, row, col), states)
            for (after, down, across, _), share in zip(
                    base.steps[kind], prob / prob.sum(), strict=True):
                if 0 <= row + down < rows and 0 <= col + across < cols:
                    matrix[source, np.ravel_multi_index(
                        (h, after, row + down, col + across), states)] += share
    matrix *= 1.0 - EXISTENCE.death_prob
    matrix[-1, :-1] = EXISTENCE.birth_prob * births(base)
    matrix[:-1, -1] = 1.0 - matrix[:-1].sum(axis=1)
    matrix[-1, -1] = 1.0 - EXISTENCE.birth_prob
    return matrix


def births(base):
    """Return the probability of every state at a birth."""
    cells = np.ones(base.resolution**2 * np.prod(SHAPE))
    prob = np.array([pair[0] for pair in all_pairs()])
    return np.multiply.outer(np.outer(prob, base.appears), cells / cells.size).ravel()


def by_matrices(base, matrices, frames, lag):
    """Return log odds, mean position and mean velocity ``lag`` frames ago."""
    where, classes = places(base), len(base.steps)
    copies = len(all_pairs()) * classes
    row, col = np.floor(where[..., ::-1] + 0.5).astype(int).reshape(-1, 2).T
    likely = [np.append(np.tile(np.exp(plane[row, col]), copies), 1.0)
              for plane in SENSOR.log_likelihood_ratio(frames)]
    weight = np.append(
        EXISTENCE.initial_prob * births(base), 1.0 - EXISTENCE.initial_prob) * likely[0]
    weights = [weight]
    for number in range(2, len(frames) + 1):
        weights.append(weights[-1] @ matrices[number] * likely[number - 1])
    later = np.ones_like(weight)
    for number in range(len(frames), len(frames) - lag, -1):
        later = matrices[number] @ (likely[number - 1] * later)
    weight = weights[len(frames) - lag - 1] * later
    place = np.tile(where.reshape(-1, 2), (copies, 1))
    velocity = np.tile(base.velocity.repeat(len(row), axis=0), (len(all_pairs()), 1))
    best = oracles.best_cell(place, weight[:-1], SHAPE)
    near = weight[:-1] * np.all(abs(np.floor(place + 0.5) - best) <= 1, axis=1)
    near /= near.sum()
    return (np.log(weight[:-1].sum() / weight[-1]), SENSOR.cell_size_m * (near @ place),
            near @ velocity)


@pytest.mark.parametrize('case', CASES)
def test_posterior_is_that_of_a_filter_by_matrices(rng, case):
    frames = rng.standard_normal((5, *SHAPE)) + 0.3
    base = base_of(build(case))
    matrices = {number: transition(base, number) for number in range(2, 6)}
    for lag in (0, 2, 3):
        for k, found in enumerate(run(build(case, lag=lag), frames), start=1):
            if k <= lag:
                continue
            log_odds, place, velocity = by_matrices(base, matrices, frames[:k], lag)
            assert found.peak == pytest.approx(log_odds, abs=1e-9)
            assert found.state[0, POS] == pytest.approx(place, abs=1e-9)
            assert found.state[0, VEL] == pytest.approx(velocity, abs=1e-9)


@pytest.mark.parametrize('case', CASES)
def test_runs_of_a_batch_share_the_destinations(rng, case):
    for lag in (0, 2):
        detector, frames = build(case, lag=lag), rng.standard_normal((5, 2, 3, *SHAPE))
        batch = run(detector, frames)
        for index in np.ndindex(2, 3):
            own = run(detector, frames[(slice(None), *index)])
            for one, other in zip(own[lag:], batch[lag:], strict=True):
                assert one.peak == pytest.approx(other.peak[index], rel=1e-9)
                assert one.state == pytest.approx(other.state[index], rel=1e-9, abs=1e-9)
