# SPDX-License-Identifier: Apache-2.0
"""With a fixed lag the answer about a frame is that of a smoothing pass over all frames so far."""

from detect import oracles
from detect.test_bernoulli import dense as moves_matrix
from detect.test_bernoulli import SLOW
from detect.test_pmf import dense as points_matrix
from detect.test_pmf import MOTION
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_detect.calibration.empty_frames import empty_frame_peaks
from lowsnr_detect.calibration.empty_frames import Simulation
from lowsnr_detect.detectors.bernoulli import Bernoulli
from lowsnr_detect.detectors.hmm import HMM
from lowsnr_detect.detectors.pmf import PMF
from lowsnr_detect.grid.fixed_lag import answers
from lowsnr_detect.grid.transitions import expect
from lowsnr_detect.parts.existence import Existence
from lowsnr_detect.parts.moved_memory import moved_memory
import numpy as np
import pytest
import scipy

ALWAYS = -1e9
SENSOR = SensorModel(snr_db=4.0, cell_size_m=2.0, frame_period_s=0.5)
SMALL = {'resolution': 1, 'headings': 4, 'speeds': 2}
LAGGED = {'hmm': HMM, 'pmf': PMF, 'bernoulli': Bernoulli}


def smoothed(transition, first, ratios):
    """
    Return the probability of every state in every frame, given all frames (K, n).

    ``transition`` is the matrix of a Markov chain, ``first`` the distribution in the first frame,
    ``ratios`` (K, n) the likelihood ratios of the frames.
    """
    forward, backward = [first * ratios[0]], [np.ones(len(first))]
    for ratio in ratios[1:]:
        forward.append(forward[-1] @ transition * ratio)
        forward[-1] /= forward[-1].sum()
    for ratio in ratios[:0:-1]:
        backward.insert(0, transition @ (ratio * backward[0]))
        backward[0] /= backward[0].sum()
    both = np.array(forward) * np.array(backward)
    return both / both.sum(axis=1, keepdims=True)


def chain(stays, births):
    """Return the transition matrix of all states and, last, of no object."""
    return np.block([
        [stays, 1.0 - stays.sum(axis=1, keepdims=True)],
        [births[None], np.array([[1.0 - births.sum()]])]])


def likelihoods(sensor, frames, cell):
    """Return the likelihood ratios (K, n + 1) of states in cells, and of no object."""
    ratios = np.exp(sensor.log_likelihood_ratio(frames))[:, *cell]
    return np.hstack([ratios, np.ones((len(frames), 1))])


@pytest.mark.parametrize('lag', [1, 3, 9])
@pytest.mark.parametrize('resolution', [1, 2])
def test_point_mass_filter_is_the_smoothing_pass_over_all_frames(rng, lag, resolution):
    shape, count = (2, 3), 7
    existence = Existence(birth_prob=0.1, death_prob=0.2, initial_prob=0.3)
    detector = PMF(sensor=SENSOR, motion=MOTION, existence=existence, lag=lag, headings=4,
                   speeds=2, resolution=resolution, threshold=ALWAYS)
    rows, cols = resolution * shape[0], resolution * shape[1]
    transitions = detector.transitions
    births = np.repeat(transitions.appears / (rows * cols), rows * cols)
    row, col = (np.tile(it.ravel(), transitions.count) for it in np.indices((rows, cols)))
    place = (np.stack([col, row], axis=-1) + 0.5) / resolution - 0.5
    frames = rng.standard_normal((count, *shape))
    ratios = likelihoods(SENSOR, frames, (row // resolution, col // resolution))
    transition = chain(
        (1.0 - existence.death_prob) * points_matrix(transitions, rows, cols),
        existence.birth_prob * births)
    first = np.r_[existence.initial_prob * births, 1.0 - existence.initial_prob]
    found = list(answers(detector, frames, rng))
    assert len(found) == count
    for number, declared in enumerate(found):
        known = min(number + lag + 1, count)
        prob = smoothed(transition, first, ratios[:known])[number]
        assert declared.peak == pytest.approx(scipy.special.logit(1.0 - prob[-1]), abs=1e-9)
        assert declared.state[0, POS] == pytest.approx(
            SENSOR.cell_size_m * oracles.local_mean(place, prob[:-1], shape), abs=1e-8)


@pytest.mark.parametrize('lag', [1, 3, 9])
@pytest.mark.parametrize('order', [0, 1])
def test_bernoulli_filter_of_one_object_is_the_smoothing_pass(rng, lag, order):
    # In so small a frame all cells compete, and no object is found.
    shape, birth, death, count = (3, 4), 0.002, 0.1, 7
    sensor = SensorModel(snr_db=6.0)
    detector = Bernoulli(sensor=sensor, motion=SLOW, order=order, birth_prob=birth, lag=lag,
                         death_prob=death, threshold=ALWAYS, max_detections=1)
    transitions = detector.transitions
    births = birth * np.repeat(transitions.appears, 12)
    row, col = (np.tile(it.ravel(), transitions.count) for it in np.indices(shape))
    place = np.stack([col, row], axis=-1)
    frames = rng.standard_normal((count, *shape))
    # An object appears whether or not there was another.
    transition = chain((1.0 - death) * moves_matrix(transitions, *shape) + births, births)
    ratios = likelihoods(sensor, frames, (row, col))
    found = list(answers(detector, frames, rng))
    assert len(found) == count
    for number, declared in enumerate(found):
        prob = smoothed(
            transition, np.r_[births, 1.0 - births.sum()],
            ratios[:min(number + lag + 1, count)])[number, :-1]
        near = np.all(abs(place - oracles.best_cell(place, prob, shape)) <= 1, axis=1)
        inside = prob[near].sum()
        assert inside < 0.2
        assert declared.peak == pytest.approx(scipy.special.logit(inside), abs=1e-8)
        assert declared.state[0, POS] == pytest.approx(prob[near] @ place[near] / inside)
        assert declared.predicted is None  # of the last answer neither


def test_two_objects_apart_are_smoothed_like_each_alone():
    # Objects at rest, 12 cells apart, of which the second appears later and the first goes.
    rest = MotionModes(turn_rates_deg_s=(0.0,), acceleration_density=0.0, max_speed_mps=1e-9)
    sensor = SensorModel(snr_db=6.0)
    detector = Bernoulli(sensor=sensor, motion=rest, order=0, lag=4, threshold=ALWAYS,
                         max_detections=2)
    rng = np.random.default_rng(5)
    both = rng.standard_normal((24, 9, 24))
    both[:16, 4, 5] += sensor.intensity
    both[8:, 4, 17] += sensor.intensity
    halves = [list(answers(detector, part, rng)) for part in (both[..., :12], both[..., 12:])]
    for number, declared in enumerate(answers(detector, both, rng)):
        alone = sorted((half[number].score[0] for half in halves), reverse=True)
        assert declared.score == pytest.approx(alone, abs=0.02)
    # Later frames tell that the second one has come.
    causal = list(answers(Bernoulli(
        sensor=sensor, motion=rest, order=0, threshold=ALWAYS), both[..., 12:], rng))
    assert np.mean([half.score[0] for half in halves[1][8:11]]) > 0.3 + np.mean(
        [half.score[0] for half in causal[8:11]])


def test_expectation_is_the_adjoint_of_the_prediction(rng):
    transitions = PMF(motion=MOTION, **SMALL).transitions
    shape = (3, 4)
    values = rng.standard_normal((transitions.count, 2, *shape))
    found = expect(transitions, values, regions=2)
    matrix = points_matrix(transitions, *shape)
    for run in range(2):
        assert found[:, run].ravel() == pytest.approx(matrix @ values[:, run].ravel(), abs=1e-12)


@pytest.mark.parametrize('name', LAGGED)
def test_every_frame_is_answered_once_and_in_order(name, rng):
    few = SMALL if name == 'pmf' else {}
    frames = rng.standard_normal((6, 2, 6, 5))
    causal = [answer.peak for answer in answers(LAGGED[name](**few), frames, rng)]
    for lag in (0, 2, 8):
        found = list(answers(LAGGED[name](lag=lag, **few), frames, rng))
        assert len(found) == 6
        # About the last frame nothing more is known than without a lag.
        assert found[-1].peak == pytest.approx(causal[-1], rel=1e-9)
        assert np.isfinite([answer.peak for answer in found]).all()


@pytest.mark.parametrize('name', LAGGED)
def test_step_declares_nothing_before_the_first_answer(name, rng):
    few = SMALL if name == 'pmf' else {}
    detector = LAGGED[name](lag=2, threshold=ALWAYS, **few)
    state, declared = detector.init((6, 5)), []
    for frame in rng.standard_normal((3, 6, 5)):
        state, answer = detector.step(state, frame, rng)
        declared.append(bool(answer.any))
    assert declared == [False, False, True]
    assert len(detector.flush(state)) == 2


@pytest.mark.parametrize('name', LAGGED)
def test_empty_frames_that_are_simulated_have_all_their_later_frames(name):
    few = SMALL if name == 'pmf' else {}
    size = Simulation(runs=3, frames=4, shape=(6, 5), seed=1)
    longer = Simulation(runs=3, frames=9, shape=(6, 5), seed=1)
    detector = LAGGED[name](lag=5, **few)
    assert empty_frame_peaks(detector, size) == pytest.approx(
        empty_frame_peaks(detector, longer)[:, :4])


@pytest.mark.parametrize('name', LAGGED)
def test_beliefs_move_with_the_cells(name, rng):
    # The camera turns while an object is in view: the answer is about the same place in the scene.
    few = SMALL if name == 'pmf' else {}
    detector = LAGGED[name](sensor=SensorModel(snr_db=12.0), lag=3, threshold=-50.0, **few)
    state, place, by = detector.init((20, 24)), np.array([9, 10]), (2, -3)
    for number in range(7):
        if number == 5:
            state = moved_memory(state, detector.init((20, 24)), (20, 24), by, 1.0)
            place = place - by
        frame = np.zeros((20, 24))
        frame[tuple(place)] = detector.sensor.intensity
        state, declared = detector.step(state, frame, rng)
    assert declared.score[0] > 0.9
    assert declared.state[0, POS] == pytest.approx(place[::-1], abs=0.5)


@pytest.mark.parametrize('name', LAGGED)
def test_memory_is_what_the_beliefs_take(name, rng):
    few = SMALL if name == 'pmf' else {}
    shape = (12, 15)
    detector = LAGGED[name](lag=4, **few)
    state = detector.init(shape)
    for frame in rng.standard_normal((8, *shape)):
        state, _ = detector.step(state, frame, rng)
    held = sum(value.nbytes for belief in state for value in vars(belief).values()
               if isinstance(value, np.ndarray))
    needed = detector.memory_bytes(shape)
    assert 0.6 * needed < held < 1.1 * needed
