# SPDX-License-Identifier: Apache-2.0
"""The point-mass filter is a Bayes filter on its states, and these follow the motion model."""

from detect import oracles
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_detect.detectors.pmf import PMF
from lowsnr_detect.grid.point_classes import point_transitions
from lowsnr_detect.grid.transitions import predict
from lowsnr_detect.parts.existence import Existence
import numpy as np
import pytest

SHAPE = (2, 3)
SENSOR = SensorModel(snr_db=4.0, cell_size_m=2.0, frame_period_s=0.5)
EXISTENCE = Existence(birth_prob=0.1, death_prob=0.2, initial_prob=0.3)
MOTION = MotionModes(
    turn_rates_deg_s=(0.0, 120.0), mode_sojourn_s=2.0, acceleration_density=0.05,
    min_speed_mps=1.0, max_speed_mps=4.0)
ALWAYS = -1e9


def run(detector, frames):
    """Return the declarations of frames (K, ..., rows, cols)."""
    state, answers = detector.init(frames.shape[1:]), []
    for frame in frames:
        state, declared = detector.step(state, frame, None)
        answers.append(declared)
    return answers


def dense(transitions, rows, cols):
    """Return the probability of every state (class, row, col) given that before, as a matrix."""
    count, modes = transitions.count, len(transitions.switch)
    matrix = np.zeros((count, rows, cols, count, rows, cols))
    for kind in range(count):
        for group in range(*transitions.first_group[kind:kind + 2]):
            down, across = transitions.step[group]
            for entry in range(*transitions.first_entry[group:group + 2]):
                mode, rest = divmod(transitions.source[entry], count // modes)
                for before, row, col in np.ndindex(modes, rows, cols):
                    if 0 <= row + down < rows and 0 <= col + across < cols:
                        matrix[before * count // modes + rest, row, col, kind, row + down,
                               col + across] += (
                            transitions.prob[entry] * transitions.switch[before, mode])
    return matrix.reshape(count * rows * cols, -1)


@pytest.mark.parametrize(('resolution', 'headings', 'speeds'), [(1, 4, 2), (2, 5, 1)])
def test_posterior_is_that_of_a_filter_by_matrices(rng, resolution, headings, speeds):
    detector = PMF(sensor=SENSOR, motion=MOTION, existence=EXISTENCE, resolution=resolution,
                   headings=headings, speeds=speeds, threshold=ALWAYS)
    rows, cols = resolution * SHAPE[0], resolution * SHAPE[1]
    transitions, chain = detector.transitions, EXISTENCE
    matrix = dense(transitions, rows, cols)
    births = np.repeat(transitions.appears / (rows * cols), rows * cols)
    row, col = (np.tile(it.ravel(), transitions.count) for it in np.indices((rows, cols)))
    place = (np.stack([col, row], axis=-1) + 0.5) / resolution - 0.5
    cell = row // resolution, col // resolution
    velocity = np.repeat(transitions.velocity, rows * cols, axis=0)
    frames = rng.standard_normal((6, *SHAPE))
    present, none = chain.initial_prob * births, 1.0 - chain.initial_prob
    for number, (frame, declared) in enumerate(zip(frames, run(detector, frames), strict=True)):
        if number:
            stays = (1.0 - chain.death_prob) * (present @ matrix)
            gone = present.sum() - stays.sum()
            present = stays + chain.birth_prob * none * births
            none = (1.0 - chain.birth_prob) * none + gone
        present = present * np.exp(SENSOR.intensity * (frame[cell] - SENSOR.intensity / 2.0))
        total = present.sum() + none
        present, none = present / total, none / total
        assert declared.peak == pytest.approx(np.log(present.sum() / none), abs=1e-10)
        assert declared.state[0, POS] == pytest.approx(
            SENSOR.cell_size_m * oracles.local_mean(place, present, SHAPE), abs=1e-9)
        # The best 3 x 3 cells hold both rows.
        near = abs(cell[1] - oracles.best_cell(place, present, SHAPE)[0]) <= 1
        assert declared.state[0, VEL] == pytest.approx(
            present[near] @ velocity[near] / present[near].sum(), abs=1e-10)


@pytest.mark.parametrize('mode', [0, 1])
def test_transitions_have_the_mean_of_the_motion_model(mode):
    headings, speeds, spacing, period = 12, 3, 0.5, 0.5
    transitions = point_transitions(MOTION, spacing, period, headings, speeds)
    angle = np.deg2rad(MOTION.turn_rates_deg_s[mode]) * period
    for kind in range(headings * speeds):
        heading, speed = divmod(kind, speeds)
        middle = 2.0 * np.pi * heading / headings
        # The mean of a uniform heading is shorter by sin(a) / a, a half of the interval.
        length = (1.5 + speed) * np.sinc(1.0 / headings)
        chord = length * period * np.sinc(angle / (2.0 * np.pi))
        step, after, total = np.zeros(2), np.zeros(2), 0.0
        for target in range(transitions.count):
            for group in range(*transitions.first_group[target:target + 2]):
                for entry in range(*transitions.first_entry[group:group + 2]):
                    if transitions.source[entry] == kind + mode * headings * speeds:
                        total += transitions.prob[entry]
                        step += transitions.prob[entry] * spacing * transitions.step[group, ::-1]
                        after += transitions.prob[entry] * transitions.velocity[target]
                        assert target // (headings * speeds) == mode
        assert total == pytest.approx(1.0)
        # Rare transitions are dropped.
        assert step == pytest.approx(
            chord * np.array([np.cos(middle + angle / 2), np.sin(middle + angle / 2)]), abs=0.04)
        # A change of heading within the interval does not show; the slowest are not slower.
        assert after == pytest.approx(
            length * np.array([np.cos(middle + angle), np.sin(middle + angle)]), abs=0.2)


def test_it_converges_to_the_exact_posterior(rng):
    # Objects on arcs, drawn by geometry; the error of 100 000 of them is below 0.02.
    sensor, shape = SensorModel(snr_db=3.0), (4, 3)
    motion = MotionModes(
        turn_rates_deg_s=(0.0, 60.0, -60.0), mode_sojourn_s=3.0, acceleration_density=0.0,
        min_speed_mps=0.3, max_speed_mps=0.9)
    frames = rng.standard_normal((4, 2, *shape)) + 0.4
    sampled = oracles.sampled_trajectories(shape, motion, 4, 100_000, rng)
    expected = np.array([oracles.presence(
        sensor.log_likelihood_ratio(frames[:, it]), sampled, EXISTENCE.birth_prob,
        EXISTENCE.death_prob, EXISTENCE.initial_prob)[0] for it in range(2)])
    error = []
    for settings in ((1, 4, 1), (3, 48, 3)):
        names = dict(zip(('resolution', 'headings', 'speeds'), settings, strict=True))
        detector = PMF(sensor=sensor, motion=motion, existence=EXISTENCE, **names)
        error.append(np.sqrt(np.mean((run(detector, frames)[-1].peak - expected)**2)))
    assert error[1] < 0.03
    assert error[1] < error[0] / 2.0


@pytest.mark.parametrize('shape', [(1, 1), (1, 9), (9, 1), (23, 17), (2, 3, 19, 5)])
def test_prediction_is_its_definition(rng, shape):
    transitions = point_transitions(MOTION, 1.0, 0.5, 6, 2)
    planes = rng.random((transitions.count, *shape))
    scale, stays, born = rng.random(shape), rng.random(shape[:-2]), rng.random(shape[:-2])
    found, mass = predict(transitions, planes, scale, stays, born, regions=2)
    kinds = transitions.count // 2
    mixed = np.einsum(
        'ab,ak...->bk...', transitions.switch, (scale * planes).reshape(2, kinds, *shape))
    mixed = mixed.reshape(planes.shape)
    expected = np.zeros_like(planes)
    rows, cols = shape[-2:]
    for kind in range(transitions.count):
        for group in range(*transitions.first_group[kind:kind + 2]):
            down, across = transitions.step[group]
            for entry in range(*transitions.first_entry[group:group + 2]):
                for row, col in np.ndindex(rows, cols):
                    if 0 <= row + down < rows and 0 <= col + across < cols:
                        expected[kind, ..., row + down, col + across] += (
                            transitions.prob[entry]
                            * mixed[transitions.source[entry], ..., row, col])
    appears = transitions.appears.reshape(-1, *[1] * len(shape))
    expected = stays[..., None, None] * expected + born[..., None, None] * appears
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    np.testing.assert_allclose(mass, expected.sum(axis=0), rtol=1e-12)
