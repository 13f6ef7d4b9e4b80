# SPDX-License-Identifier: Apache-2.0
"""The local Bernoulli filter is exact for one object and for two that are apart."""

import itertools

from detect import oracles
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_detect.detectors.bernoulli import Bernoulli
from lowsnr_detect.grid.move_classes import move_transitions
from lowsnr_detect.parts.moves import move_model
import numpy as np
import pytest
import scipy

SENSOR = SensorModel(snr_db=6.0)
SLOW = MotionModes(
    turn_rates_deg_s=(0.0,), acceleration_density=0.0, min_speed_mps=0.1, max_speed_mps=0.6)
ALWAYS = -1e9


def run(detector, frames):
    """Return memory and declarations of frames (K, ..., rows, cols)."""
    state, answers = detector.init(frames.shape[1:]), []
    for frame in frames:
        state, declared = detector.step(state, frame, None)
        answers.append((state, declared))
    return answers


def dense(transitions, rows, cols):
    """Return the probability of every state (class, row, col) given that before, as a matrix."""
    matrix = np.zeros((transitions.count, rows, cols, transitions.count, rows, cols))
    for kind in range(transitions.count):
        for group in range(*transitions.first_group[kind:kind + 2]):
            down, across = transitions.step[group]
            for entry in range(*transitions.first_entry[group:group + 2]):
                for row, col in np.ndindex(rows, cols):
                    if 0 <= row + down < rows and 0 <= col + across < cols:
                        matrix[transitions.source[entry], row, col, kind, row + down,
                               col + across] = transitions.prob[entry]
    return matrix.reshape(transitions.count * rows * cols, -1)


@pytest.mark.parametrize('order', [0, 1, 2])
def test_one_object_that_is_not_found_yet_has_the_posterior_of_a_bernoulli_filter(rng, order):
    # In so small a frame all cells compete: the filter of one object with births everywhere.
    shape, birth, death = (3, 4), 0.002, 0.1
    detector = Bernoulli(sensor=SENSOR, motion=SLOW, order=order, birth_prob=birth,
                         death_prob=death, threshold=ALWAYS, max_detections=1)
    transitions = detector.transitions
    matrix = dense(transitions, *shape)
    births = birth * np.repeat(transitions.appears, 12)
    row, col = (np.tile(it.ravel(), transitions.count) for it in np.indices(shape))
    velocity = np.repeat(transitions.velocity, 12, axis=0)
    prob = np.zeros(len(matrix))
    frames = rng.standard_normal((6, *shape))
    for frame, (_, declared) in zip(frames, run(detector, frames), strict=True):
        prob = births + (1.0 - death) * (prob @ matrix)
        absent, before = 1.0 - prob.sum(), prob
        prob = prob * np.exp(SENSOR.intensity * (frame[row, col] - SENSOR.intensity / 2.0))
        prob /= absent + prob.sum()
        place = np.stack([col, row], axis=-1)
        best = oracles.best_cell(place, prob, shape)
        near = np.all(abs(place - best) <= 1, axis=1)
        inside = prob[near].sum()
        assert inside < 0.2  # not yet found
        assert declared.peak == pytest.approx(scipy.special.logit(inside), abs=1e-9)
        assert declared.state[0, POS] == pytest.approx(prob[near] @ place[near] / inside)
        assert declared.state[0, VEL] == pytest.approx(
            prob[near] @ velocity[near] / inside, abs=1e-12)
        check_prediction(declared.estimates()[0].predicted, before[near], place[near])


def check_prediction(predicted, prob, place):
    """Check what was expected of an object, against the probability of every state before."""
    assert predicted.score == pytest.approx(prob.sum(), abs=1e-12)
    assert predicted.position == pytest.approx(np.average(place, axis=0, weights=prob))
    # Around a point the place is uniform in its cell.
    assert predicted.cov == pytest.approx(
        np.cov(place.T, aweights=prob, ddof=0) + np.eye(2) / 12.0, abs=1e-9)


def two_objects(frames, model, birth, death, lag=0):
    """
    Return the expected number of objects in every cell ``lag`` frames ago, by all their states.

    Each is in one of the cells of a row or absent; together they are where both are, and a cell
    with both is as bright as with one.
    """
    count = frames.shape[-1]
    single = np.zeros((count + 1, count + 1))
    for cell, (move, prob) in itertools.product(
            range(count), zip(model.moves, model.kernel[0, :, 0], strict=True)):
        if move[0] == 0 and 0 <= cell + move[1] < count:
            single[cell, cell + move[1]] += (1.0 - death) * prob
    # Each of the two appears with half of the probability of a cell.
    single[-1, :-1] = birth / 2.0
    single[:, -1] = 1.0 - single[:, :-1].sum(axis=1)
    both, ones = np.zeros((count + 1, count + 1)), np.eye(count + 1)[:-1]
    both[-1, -1] = 1.0
    lit = np.maximum(ones[:, :, None], ones[:, None, :])
    ratios = [np.prod(np.where(lit > 0.0, each[:, None, None], 1.0), axis=0)
              for each in np.exp(SENSOR.log_likelihood_ratio(frames[:, 0]))]
    for ratio in ratios[:len(ratios) - lag]:
        both = single.T @ both @ single * ratio
        both /= both.sum()
    later = np.ones_like(both)
    for ratio in ratios[:len(ratios) - lag - 1:-1]:
        later = single @ (ratio * later) @ single.T
        later /= later.max()
    both *= later / np.sum(both * later)
    return both[:-1].sum(axis=1) + both[:, :-1].sum(axis=0)


@pytest.mark.parametrize('lag', [0, 3])
@pytest.mark.parametrize('apart', [3, 4, 6])
def test_two_objects_have_the_masses_of_the_enumeration(apart, lag):
    # A single row: moves to other rows leave the frame, in both.
    rng, birth, death, differences = np.random.default_rng(apart), 1e-3, 0.03, []
    rest = MotionModes(turn_rates_deg_s=(0.0,), acceleration_density=0.0, max_speed_mps=1e-9)
    model = move_model(rest, SENSOR, 0)
    detector = Bernoulli(sensor=SENSOR, motion=rest, order=0, birth_prob=birth, death_prob=death,
                         threshold=ALWAYS, lag=lag)
    for _ in range(20):
        frames = rng.standard_normal((12, 1, 14))
        frames[:, 0, [4, 4 + apart]] += SENSOR.intensity
        expected = two_objects(frames, model, birth, death, lag)
        state, _ = run(detector, frames)[-1]
        differences.append(detector.smoothed_mass(state).mass[0] - expected)
    differences = np.array(differences)
    assert abs(differences.mean(axis=0)).max() < 0.1
    assert np.sqrt(np.mean(differences**2)) < 0.1


def test_neighbours_are_both_declared(rng):
    # Figures of 60 runs: .93 at 3 cells and .96 at 5.
    sensor, hits = SensorModel(snr_db=9.0), {}
    for apart in (3, 5):
        detector = Bernoulli(sensor=sensor, threshold=0.0)
        truth = np.array([
            [[14.5 + 0.4 * (k - 12), 0.4, 14.5 - apart / 2.0 + apart * n, 0.0] for n in (0, 1)]
            for k in range(25)])
        frames = rng.standard_normal((25, 20, 30, 30)) + np.stack([
            sum(sensor.signal(state, (30, 30)) for state in states) for states in truth])[:, None]
        hits[apart] = np.mean([
            both_hit(declared, states) for states, (_, declared)
            in list(zip(truth, run(detector, frames), strict=True))[6:]])
    assert hits[3] > 0.85
    assert hits[5] > 0.9


def both_hit(declared, states):
    """Return the fraction of objects with a declaration of their own within 1.5 cells."""
    found = []
    for run_state in declared.state[..., POS]:
        away = np.linalg.norm(run_state[:, None] - states[:, POS], axis=-1)
        away = np.where(np.isfinite(away), away, 1e3)
        rows, cols = scipy.optimize.linear_sum_assignment(np.minimum(away, 2.0))
        found.append(np.sum(away[rows, cols] <= 1.5) / len(states))
    return np.mean(found)


@pytest.mark.parametrize('order', [0, 1, 2])
def test_rare_moves_are_left_out_and_the_others_scaled(order):
    motion = MotionModes(min_speed_mps=0.3, max_speed_mps=0.9)
    transitions, model = move_transitions(motion, SENSOR, order), move_model(motion, SENSOR, order)
    sums = np.bincount(transitions.source, weights=transitions.prob, minlength=transitions.count)
    assert sums == pytest.approx(np.ones(transitions.count))
    assert transitions.prob.min() > 0.004
    assert transitions.appears.sum() == pytest.approx(1.0)
    # The mean step of an object that has just appeared, by class of what it does then.
    expected = np.einsum('kmd,dk,mi->i', model.kernel, model.history, model.moves)
    groups = np.repeat(np.arange(len(transitions.step)), np.diff(transitions.first_entry))
    weight = transitions.prob * transitions.appears[transitions.source]
    assert weight @ transitions.step[groups] == pytest.approx(expected, abs=0.01)
    if order == 2:
        assert transitions.count < model.history.size
