# SPDX-License-Identifier: Apache-2.0
"""The grid filter is the sum over all trajectories."""

from dataclasses import replace

from detect import oracles
from lowsnr_common.core.destination import Destination
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_detect.detectors.hmm import HMM
from lowsnr_detect.parts.destination_moves import cell_likelihoods
from lowsnr_detect.parts.destination_moves import move_likelihoods
from lowsnr_detect.parts.existence import Existence
from lowsnr_detect.parts.moves import move_model
import numpy as np
import pytest

SHAPE = (4, 3)
FRAMES = 5
SENSOR = SensorModel(snr_db=4.0)
EXISTENCE = Existence(birth_prob=0.1, death_prob=0.2, initial_prob=0.3)
ALWAYS = -1e9


def run(detector, frames):
    """Return the declarations of frames (K, ..., rows, cols)."""
    state, answers = detector.init(frames.shape[1:]), []
    for frame in frames:
        state, declared = detector.step(state, frame, None)
        answers.append(declared)
    return answers


def exact(detector, frames, at=-1):
    """Return log odds and mean position of frame ``at`` by enumeration."""
    model = move_model(detector.motion, detector.sensor, detector.order)
    trajectories = oracles.grid_trajectories(
        frames.shape[1:], model.moves, model.kernel, model.history, len(frames))
    chain = detector.existence
    return oracles.presence(
        detector.sensor.log_likelihood_ratio(frames), trajectories, chain.birth_prob,
        chain.death_prob, chain.initial_prob, at)


@pytest.mark.parametrize('order', [0, 1, 2])
def test_posterior_is_the_sum_over_all_trajectories(rng, order):
    # Order 2 costs the enumeration 81 histories for each of its sequences.
    count = FRAMES if order < 2 else FRAMES - 1
    detector = HMM(sensor=SENSOR, existence=EXISTENCE, order=order, threshold=ALWAYS)
    frames = rng.standard_normal((count, *SHAPE))
    answers = run(detector, frames)
    for k in range(1, count + 1):
        log_odds, position = exact(detector, frames[:k])
        assert answers[k - 1].peak == pytest.approx(log_odds, abs=1e-10)
        assert answers[k - 1].state[0, [0, 2]] == pytest.approx(position, abs=1e-10)


@pytest.mark.parametrize('lag', [1, 2, 3])
def test_fixed_lag_is_the_sum_over_all_trajectories_with_later_frames(rng, lag):
    detector = HMM(sensor=SENSOR, existence=EXISTENCE, order=1, lag=lag, threshold=ALWAYS)
    frames = rng.standard_normal((FRAMES, *SHAPE))
    answers = run(detector, frames)
    for k in range(1, FRAMES + 1):
        if k <= lag:
            assert not answers[k - 1].any
            continue
        log_odds, position = exact(detector, frames[:k], at=k - 1 - lag)
        assert answers[k - 1].peak == pytest.approx(log_odds, abs=1e-10)
        assert answers[k - 1].state[0, [0, 2]] == pytest.approx(position, abs=1e-10)


@pytest.mark.parametrize('lag', [0, 2])
@pytest.mark.parametrize('order', [0, 1, 2])
def test_flat_likelihood_leaves_existence_at_its_prior(order, lag):
    # An object at rest cannot leave the frame, so that only the chain changes its existence.
    motion = MotionModes(max_speed_mps=1e-9, acceleration_density=0.0)
    detector = HMM(sensor=SENSOR, motion=motion, existence=EXISTENCE, order=order, lag=lag)
    # One part in 400 000 of the moves is not at rest: none is impossible in the model.
    flat = np.full((8, *SHAPE), SENSOR.intensity / 2.0)
    prob = EXISTENCE.initial_prob
    for declared in run(detector, flat)[lag:]:
        assert 1.0 / (1.0 + np.exp(-declared.peak)) == pytest.approx(prob, abs=1e-4)
        prob = EXISTENCE.birth_prob * (1 - prob) + (1 - EXISTENCE.death_prob) * prob


def test_covariance_is_that_of_the_posterior(rng):
    detector = HMM(sensor=SENSOR, existence=EXISTENCE, order=1, threshold=ALWAYS)
    frames = rng.standard_normal((3, *SHAPE))
    state = detector.init(SHAPE)
    for frame in frames:
        state, declared = detector.step(state, frame, None)
    model, belief = move_model(detector.motion, SENSOR, 1), state[-1].given[:, :, 0]
    mass = {(row, col): belief[:, :, max(row - 1, 0):row + 2, max(col - 1, 0):col + 2].sum()
            for row, col in np.ndindex(*SHAPE)}
    best = max(mass, key=mass.get)
    mean, second = np.zeros(4), np.zeros((4, 4))
    within = np.zeros((4, 4))
    within[0, 0] = within[2, 2] = 1.0 / 12.0
    for (dropped, kept, row, col), prob in np.ndenumerate(belief / mass[best]):
        if max(abs(row - best[0]), abs(col - best[1])) > 1:
            continue
        velocity = model.velocity[dropped, kept]
        x = np.array([col, velocity[0], row, velocity[1]])
        inner = within.copy()
        inner[np.ix_([1, 3], [1, 3])] = model.velocity_cov[dropped, kept]
        mean += prob * x
        second += prob * (np.outer(x, x) + inner)
    assert belief.sum() == pytest.approx(1.0)
    assert declared.state[0] == pytest.approx(mean)
    assert declared.cov[0] == pytest.approx(second - np.outer(mean, mean))


@pytest.mark.parametrize('lag', [0, 3])
def test_outliers_far_apart_leave_numbers(lag):
    detector = HMM(sensor=SENSOR, lag=lag, threshold=-50.0)
    frames = np.zeros((8, 7, 5))
    for k, cell in ((1, (0, 0)), (2, (6, 4)), (3, (0, 4))):
        frames[(k, *cell)] = 1e6
    for declared in run(detector, frames)[lag:]:
        assert np.isfinite(declared.peak)
        assert np.isfinite(declared.state).all() or not declared.any


@pytest.mark.parametrize('snr_db', [-20.0, 60.0])
def test_extreme_snr_leaves_numbers(rng, snr_db):
    detector = HMM(sensor=replace(SENSOR, snr_db=snr_db), lag=2)
    answers = run(detector, rng.standard_normal((6, 7, 5)))
    assert all(np.isfinite(declared.peak) for declared in answers[2:])


def hidden_states(detector, shape):
    """Return all (dropped, kept, row, col); to be absent is one more state, the last."""
    model = move_model(detector.motion, SENSOR, detector.order)
    return list(np.ndindex(*model.history.shape, *shape))


def appearing(detector, shape, number):
    """Return the probability to appear so, by hidden state."""
    model = move_model(detector.motion, SENSOR, detector.order)
    prob = np.broadcast_to(model.history[..., None, None], (*model.history.shape, *shape))
    if detector.destination.is_ahead(number):
        prob = prob * cell_likelihoods(
            detector.destination, detector.motion, SENSOR, detector.order, number, shape)
    return prob.ravel() / np.prod(shape)


def transition(detector, shape, number):
    """Return the matrix of all hidden states before and in a frame."""
    states, order, chain = hidden_states(detector, shape), detector.order, detector.existence
    model = move_model(detector.motion, SENSOR, order)
    matrix = np.zeros((len(states) + 1, len(states) + 1))
    for n, (dropped, kept, row, col) in enumerate(states):
        prob = model.kernel[kept, :, dropped]
        if detector.destination.is_ahead(number):
            factor, mean = move_likelihoods(
                detector.destination, detector.motion, SENSOR, order, number, shape)
            prob = prob * factor[kept, :, row, col] / mean[dropped, kept, row, col]
        for m, (down, across) in enumerate(model.moves):
            history = ((0, 0), (m, 0), (kept, m))[order]
            if (after := (*history, row + down, col + across)) in states:
                matrix[n, states.index(after)] += (1.0 - chain.death_prob) * prob[m]
    matrix[-1, :-1] = chain.birth_prob * appearing(detector, shape, number)
    matrix[:-1, -1] = 1.0 - matrix[:-1].sum(axis=1)
    matrix[-1, -1] = 1.0 - chain.birth_prob
    return matrix


def by_matrices(detector, frames, lag=0):
    """Return log odds and mean position ``lag`` frames ago, over every sequence of states."""
    shape, start = frames.shape[1:], detector.existence.initial_prob
    ratio = SENSOR.log_likelihood_ratio(frames)
    cells = np.array(hidden_states(detector, shape))[:, 2:]
    weight, weights = np.append(start * appearing(detector, shape, 1), 1.0 - start), []
    for number, plane in enumerate(ratio, start=1):
        if number > 1:
            weight = weight @ transition(detector, shape, number)
        weights.append(weight := weight * np.append(np.exp(plane[tuple(cells.T)]), 1.0))
    later = np.ones_like(weight)
    for number in range(len(frames), len(frames) - lag, -1):
        later = transition(detector, shape, number) @ (
            np.append(np.exp(ratio[number - 1][tuple(cells.T)]), 1.0) * later)
    weight = weights[len(frames) - lag - 1] * later
    present = weight[:-1].sum()
    return np.log(present / weight[-1]), oracles.local_mean(cells[:, ::-1], weight[:-1], shape)


@pytest.mark.parametrize(('order', 'shape', 'count', 'arrival', 'lag'), [
    (0, (4, 3), 5, 5, 0), (0, (2, 3), 5, 3, 0), (1, (3, 4), 4, 4, 0), (1, (4, 3), 4, 2, 0),
    (2, (2, 3), 3, 3, 0), (0, (2, 3), 5, 3, 2), (1, (3, 4), 4, 4, 2), (1, (4, 3), 4, 2, 3)])
def test_with_a_destination_it_is_the_sum_over_all_sequences(
    rng, order, shape, count, arrival, lag,
):
    to = Destination(probability=0.8, x_m=2.0, y_m=0.5, std_m=0.7, arrival_frame=arrival)
    detector = HMM(sensor=SENSOR, existence=EXISTENCE, order=order, threshold=ALWAYS,
                   destination=to, lag=lag)
    frames = rng.standard_normal((count, *shape))
    answers = run(detector, frames)
    for k in range(1 + lag, count + 1):
        log_odds, position = by_matrices(detector, frames[:k], lag)
        assert answers[k - 1].peak == pytest.approx(log_odds, abs=1e-10)
        assert answers[k - 1].state[0, [0, 2]] == pytest.approx(position, abs=1e-10)


@pytest.mark.parametrize('order', [0, 1, 2])
def test_runs_of_a_batch_share_the_destination(rng, order):
    to = Destination(probability=0.8, x_m=2.0, y_m=0.5, arrival_frame=3)
    detector = HMM(sensor=SENSOR, order=order, threshold=ALWAYS, destination=to)
    frames = rng.standard_normal((4, 2, 3, *SHAPE))
    batch = run(detector, frames)
    for index in np.ndindex(2, 3):
        for one, other in zip(run(detector, frames[(slice(None), *index)]), batch, strict=True):
            assert one.peak == pytest.approx(other.peak[index], rel=1e-9)
            assert one.state == pytest.approx(other.state[index], rel=1e-9, abs=1e-9)
