# SPDX-License-Identifier: Apache-2.0
"""The particle filters converge to the exact posterior, and their settings are one filter."""

from dataclasses import replace

from detect import oracles
from lowsnr_common.core.destination import Destination
from lowsnr_common.core.destination import state_likelihood
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_detect.detectors.tbd1 import MMTBD1
from lowsnr_detect.detectors.tbd1 import TBD1
from lowsnr_detect.detectors.tbd2 import MMTBD2
from lowsnr_detect.detectors.tbd2 import TBD2
from lowsnr_detect.parts.births import ConstantVelocity
from lowsnr_detect.parts.births import draw_births
from lowsnr_detect.parts.births import log_birth_proposal
from lowsnr_detect.parts.existence import Existence
import numpy as np
import pytest

SHAPE = (4, 3)
FRAMES = 5
SENSOR = SensorModel(snr_db=3.0)
EXISTENCE = Existence(birth_prob=0.1, death_prob=0.2, initial_prob=0.3)
# Without process noise a trajectory consists of arcs, which the oracle draws by geometry.
TURNS = MotionModes(
    turn_rates_deg_s=(0.0, 60.0, -60.0), mode_sojourn_s=3.0, acceleration_density=0.0,
    min_speed_mps=0.3, max_speed_mps=0.9)
REST = MotionModes(
    turn_rates_deg_s=(0.0, 60.0, -60.0), mode_sojourn_s=3.0, acceleration_density=0.0,
    max_speed_mps=1e-9)
ALWAYS = -1e9


def sized(cls, particles, **settings):
    """Return a filter with a number of particles in all."""
    if issubclass(cls, MMTBD2):
        return cls(particles=particles // 2, birth_particles=particles // 2, **settings)
    return cls(particles=particles, **settings)


def run(detector, frames, rng):
    """Return the declarations of frames (K, ..., rows, cols) and the last memory."""
    state, answers = detector.init(frames.shape[1:]), []
    for frame in frames:
        state, declared = detector.step(state, frame, rng)
        answers.append(declared)
    return answers, state


@pytest.mark.parametrize('cls', [MMTBD1, MMTBD2])
def test_converges_to_the_exact_posterior(rng, cls):
    # 150 filters on the same frames; the error of the exact odds, from 400 000 sampled
    # trajectories of equal weight, is below 0.01.  Tolerances are four standard errors.
    runs = 150
    frames = rng.standard_normal((FRAMES, *SHAPE)) + 0.4
    trajectories = oracles.sampled_trajectories(SHAPE, TURNS, FRAMES, 400_000, rng)
    chain = EXISTENCE
    log_odds, position = oracles.presence(
        SENSOR.log_likelihood_ratio(frames), trajectories, chain.birth_prob, chain.death_prob,
        chain.initial_prob)
    error = {}
    for particles in (400, 6400):
        detector = sized(cls, particles, sensor=SENSOR, motion=TURNS, existence=chain,
                         threshold=ALWAYS)
        batch = np.broadcast_to(frames[:, None], (FRAMES, runs, *SHAPE))
        last = run(detector, batch, rng)[0][-1]
        error[particles] = np.sqrt(np.mean((last.peak - log_odds)**2))
        bias = abs(last.peak.mean() - log_odds)
        assert bias < 4 * last.peak.std() / np.sqrt(runs) + error[particles]**2 + 0.01
    # With fewer particles another local mode of the posterior may look like the best.
    spread = 4 * np.std(last.state[:, 0, [0, 2]], axis=0) / np.sqrt(runs) + 0.01
    assert np.all(abs(last.state[:, 0, [0, 2]].mean(axis=0) - position) < spread)
    # Sixteen times the particles, a quarter of the error: 150 runs tell it to 12 %.
    assert 2.5 < error[400] / error[6400] < 6.0
    assert error[6400] < 0.06


@pytest.mark.parametrize('cls', [MMTBD1, MMTBD2])
def test_flat_likelihood_leaves_existence_and_modes_at_their_priors(rng, cls):
    runs, particles, frames = 60, 600, 9
    detector = sized(cls, particles, sensor=SENSOR, motion=REST, existence=EXISTENCE)
    flat = np.full((frames, runs, *SHAPE), SENSOR.intensity / 2.0)
    answers, state = run(detector, flat, rng)
    prob = EXISTENCE.initial_prob
    for declared in answers:
        found = 1.0 / (1.0 + np.exp(-declared.peak))
        # TBD2 carries the probability itself, TBD1 samples it: four standard errors.
        error = 1e-9 if cls is MMTBD2 else 4 * frames**0.5 * 0.5 / np.sqrt(runs * particles)
        assert found.mean() == pytest.approx(prob, abs=error)
        prob = EXISTENCE.birth_prob * (1 - prob) + (1 - EXISTENCE.death_prob) * prob
    exists = getattr(state, 'exists', np.ones(state.modes.shape, bool))
    fraction = np.bincount(state.modes[exists], minlength=3) / exists.sum()
    # Resampling duplicates particles about ten times: there are fewer independent draws.
    assert fraction == pytest.approx(np.full(3, 1 / 3), abs=4 * 0.47 / np.sqrt(exists.sum() / 10))


def test_mode_chain_under_a_flat_likelihood_is_the_prior_chain(rng):
    detector = MMTBD2(sensor=SENSOR, motion=REST, existence=EXISTENCE, particles=300_000,
                      birth_particles=1)
    flat = np.full(SHAPE, SENSOR.intensity / 2.0)
    state, _ = detector.step(None, flat, rng)
    state = replace(state, modes=np.zeros_like(state.modes), log_odds=np.array(40.0))
    expected = np.array([1.0, 0.0, 0.0])
    for _ in range(3):
        state, _ = detector.step(replace(state, log_odds=np.array(40.0)), flat, rng)
        expected = expected @ REST.mode_transition(1.0)
        fraction = np.bincount(state.modes, minlength=3) / state.modes.size
        assert fraction == pytest.approx(expected, abs=4 * 0.5 / np.sqrt(300_000))


@pytest.mark.parametrize(('several', 'single'), [(MMTBD1, TBD1), (MMTBD2, TBD2)])
def test_one_mode_is_the_single_model_filter_byte_for_byte(seed, several, single):
    frames = np.random.default_rng(seed).standard_normal((12, 2, 7, 5))
    one = sized(several, 200, motion=MotionModes(turn_rates_deg_s=(0.0,)), threshold=ALWAYS)
    other = sized(single, 200, threshold=ALWAYS)
    assert other.motion.count == 1
    answers = [run(it, frames, np.random.default_rng(seed))[0] for it in (one, other)]
    for a, b in zip(*answers, strict=True):
        for name in ('peak', 'score', 'state', 'cov'):
            assert getattr(a, name).tobytes() == getattr(b, name).tobytes()


@pytest.mark.parametrize('cls', [MMTBD1, MMTBD2])
def test_object_that_leaves_the_frame_is_gone(cls):
    # It leaves at the right edge; P_d alone would keep it for more than ten frames.
    motion = ConstantVelocity(min_speed_mps=0.9, max_speed_mps=1.0, acceleration_density=0.0)
    detector = sized(cls, 2000, sensor=SensorModel(snr_db=14.0), motion=motion,
                     existence=Existence(death_prob=0.001), threshold=0.0)
    frames = np.zeros((9, 5, 6))
    for k in range(5):
        frames[k, 2, k + 1] = detector.sensor.intensity
    answers, _ = run(detector, frames, np.random.default_rng(1))
    assert answers[4].any
    assert answers[4].state[0, 1] == pytest.approx(0.95, abs=0.1)
    assert not any(declared.any for declared in answers[6:])


def test_birth_proposal_is_bright_and_sums_to_one(rng):
    ratio = 3.0 * rng.standard_normal((2, 7, 5))
    log_prob = log_birth_proposal(ratio)
    assert np.exp(log_prob).sum(axis=-1) == pytest.approx(np.ones(2))
    assert np.array_equal(log_prob.argmax(-1), ratio.reshape(2, -1).argmax(-1))
    assert np.exp(log_prob).min() >= 0.1 / 35


def test_births_are_within_their_cell_and_speed_limits(rng):
    sensor, motion = SensorModel(cell_size_m=2.5), MotionModes(min_speed_mps=0.3)
    cells = rng.integers(35, size=(4, 1000))
    states, modes = draw_births(cells, 5, sensor, motion, rng)
    found = sensor.cells(states)
    assert np.array_equal(found[..., 0] * 5 + found[..., 1], cells)
    speed = np.hypot(states[..., 1], states[..., 3])
    assert np.all((speed >= 0.3) & (speed <= motion.max_speed_mps))
    assert set(modes.ravel()) == {0, 1, 2}


def brute_force(frames, motion, to, rng):
    """
    Return odds and mean position of an object that exists from the start with probability 0.99.

    A million objects of the base motion, weighted by h where they are, or where they left.
    """
    count = 1_000_000
    rows, cols = frames.shape[1:]
    cells = rng.integers(rows * cols, size=count)
    states, modes = draw_births(cells, cols, SENSOR, motion, rng)
    sums, inside, gone = np.zeros(count), np.ones(count, bool), np.zeros(count)
    for number, ratio in enumerate(SENSOR.log_likelihood_ratio(frames), start=1):
        if number > 1:
            modes = motion.switch(modes, 1.0, rng)
            states = motion.move(states, modes, 1.0, rng)
        if to.is_ahead(number):
            factor = state_likelihood(to, states, number, 1.0, float(rows * cols))
        row, col = SENSOR.cells(states).T
        here = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
        gone += np.where(inside & ~here, np.exp(sums) * factor, 0.0)
        inside &= here
        sums += ratio[row.clip(0, rows - 1), col.clip(0, cols - 1)]
    weight = np.where(inside, np.exp(sums) * factor, 0.0)
    return (np.log(0.99 * weight.mean() / (0.01 + 0.99 * gone.mean())),
            oracles.local_mean(states[:, [0, 2]], weight, (rows, cols)))


@pytest.mark.parametrize(('cls', 'arrival', 'density'), [
    (TBD2, 4, 0.05), (MMTBD2, 4, 0.05), (MMTBD2, 3, 0.05), (TBD2, 6, 10.0)])
def test_with_a_destination_it_converges_to_weighted_base_motion(rng, cls, arrival, density):
    to = Destination(probability=0.8, x_m=4.0, y_m=1.0, std_m=0.6, arrival_frame=arrival,
                     acceleration_density=density)
    motion = MotionModes(acceleration_density=0.05, mode_sojourn_s=3.0, min_speed_mps=0.3)
    motion = motion if cls is MMTBD2 else motion.single()
    runs, frames = 100, rng.standard_normal((4, 5, 6)) + 0.4
    detector = cls(
        sensor=SENSOR, motion=motion, destination=to, particles=6000, birth_particles=6000,
        existence=Existence(birth_prob=1e-9, death_prob=1e-9, initial_prob=0.99),
        threshold=ALWAYS)
    log_odds, position = brute_force(frames, motion, to, rng)
    last = run(detector, np.broadcast_to(frames[:, None], (4, runs, 5, 6)), rng)[0][-1]
    # The error of the oracle, of a million weighted objects, is below 0.01.
    assert abs(last.peak.mean() - log_odds) < 4 * last.peak.std() / np.sqrt(runs) + 0.01
    spread = 4 * np.std(last.state[:, 0, [0, 2]], axis=0) / np.sqrt(runs) + 0.01
    assert np.all(abs(last.state[:, 0, [0, 2]].mean(axis=0) - position) < spread)
