# SPDX-License-Identifier: Apache-2.0
"""The model of the detector: likelihood ratio of scores, secondary detections, clutter."""

from dataclasses import replace

from lowsnr_track.detection_model import DetectionModel
from lowsnr_track.measurements import Measurements
from lowsnr_track.pda_mmpf import PdaMmpf
from lowsnr_track.track_management import TrackLife
import numpy as np
import pytest
from scipy.stats import expon
from track.scenes import detection
from track.scenes import follow


def at(positions, scores):
    """Return measurements at positions (m, 2)."""
    return Measurements(
        np.array(positions, dtype=float), np.stack([np.eye(2)] * len(scores)), np.array(scores))


def test_score_ratio_is_one_on_average_over_noise():
    """The log ratio of noise above a threshold: exponential, one nat a nat, cut off."""
    model, draws = DetectionModel(score_limit=4.0), 100_000
    odds = np.random.default_rng(1).exponential(1.0, draws)
    ratio = model.score_ratio(1.0 / (1.0 + np.exp(-odds)))
    assert ratio.mean() == pytest.approx(1.0, abs=5 * ratio.std() / np.sqrt(draws))


@pytest.mark.parametrize('score', [0.0, 0.2, 0.5, 0.9, 1.0])
def test_score_ratio_is_in_proportion_to_the_odds_within_its_limits(score):
    odds = np.clip(score / max(1.0 - score, 1e-300), 1.0, np.exp(10.0))
    found = DetectionModel(score_limit=10.0).score_ratio(np.array([score, 0.5]))
    assert found[0] / found[1] == pytest.approx(odds)


def test_unused_scores_have_ratio_one_and_no_secondary_density():
    model = DetectionModel(use_scores=False)
    assert model.score_ratio(np.array([0.1, 1.0])).tolist() == [1.0, 1.0]
    assert model.secondary(at([[0, 0], [1, 0]], [0.9, 0.6]), 5.0).tolist() == [0.0, 0.0]


def test_only_the_weaker_of_near_detections_may_be_secondary():
    measured = at([[5, 5], [7, 4], [9, 5], [8, 9]], [0.9, 0.6, 0.7, 0.5])
    # Of the first within two cells: the second; of the third, too. The last stands alone.
    model = DetectionModel(secondary_density=0.1)
    assert model.secondary(measured, 2.0).tolist() == [0.0, 0.1, 0.0, 0.0]


def test_estimated_clutter_density_approaches_the_true_one():
    tracker = PdaMmpf(
        rows=16, cols=24, particles=50,
        detection=DetectionModel(use_scores=False, clutter_memory_frames=400))
    rng, rate, frames = np.random.default_rng(2), 1.5, 1600
    found = [
        [detection(*rng.uniform([0.0, 0.0], [23.0, 15.0])) for _ in range(rng.poisson(rate))]
        for _ in range(frames)]
    state = tracker.init()
    for k, detections in enumerate(found, start=1):
        state, _ = tracker.step(state, detections, float(k), rng)
    # An exponential mean over 400 frames has the variance of a mean over 800. A few detections
    # start a track, and count for less.
    error = 4 * np.sqrt(rate / 800)
    assert rate - error - 0.1 * rate < state.clutter_density * 16 * 24 < rate + error


@pytest.mark.parametrize('frames', [0, 1, 7])
def test_first_estimates_are_posterior_means_of_a_poisson_rate(frames):
    """The prior is a gamma distribution of shape 4 x 0.02 x 100 and rate 4 frames."""
    model, cells, density = DetectionModel(clutter_prior_frames=4), 100, 0.02
    for k in range(frames + 1):
        density = model.estimated_clutter(density, k, cells, k)
    shape = 4 * 0.02 * cells + sum(range(frames + 1))
    assert density * cells == pytest.approx(shape / (4 + frames + 1))


def test_estimated_clutter_density_never_reaches_zero():
    density = 0.01
    for k in range(2000):
        density = DetectionModel().estimated_clutter(density, 0.0, 100, k)
    # Jeffreys' prior for a Poisson rate: (0 + 1/2) / 100 frames.
    assert density * 100 == pytest.approx(0.5 / 100)


def test_given_clutter_density_stays_without_estimation(rng):
    tracker = PdaMmpf(
        rows=16, cols=24, particles=50, detection=DetectionModel(clutter_memory_frames=0))
    state, _ = tracker.step(tracker.init(), [detection(3, 3), detection(9, 9)], 1.0, rng)
    assert state.clutter_density == tracker.detection.clutter_density


def test_higher_clutter_density_delays_confirmation(rng):
    frames = [[detection(8, 8, variance=0.1)]] * 30
    first = []
    for density in (1e-4, 2e-3):
        tracker = PdaMmpf(rows=16, cols=24, detection=DetectionModel(
            use_scores=False, clutter_density=density, clutter_memory_frames=0),
            life=TrackLife(confirm_probability=0.95))
        tracker = replace(tracker, motion=replace(tracker.motion, max_speed_mps=0.1))
        first.append([bool(output.confirmed) for output in follow(tracker, frames, rng)].index(
            True))
    assert first[0] < first[1]


@pytest.mark.parametrize('use_scores', [False, True])
def test_repetition_is_the_ratio_of_two_exponentials(use_scores):
    model = DetectionModel(use_scores=use_scores)
    x = np.array([0.0, 2.0, 20.0])
    found = model.repetition(1.0 / (1.0 + np.exp(-x))) * model.in_gate_probability
    expected = expon.pdf(x, scale=1.7) / expon.pdf(x, scale=5.0) if use_scores else np.ones(3)
    assert found == pytest.approx(expected, rel=1e-6)
