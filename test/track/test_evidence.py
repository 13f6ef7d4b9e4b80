# SPDX-License-Identifier: Apache-2.0
"""Soft evidence: a track takes from posteriors what is new in a frame, and nothing twice."""

from dataclasses import replace

from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Prediction
from lowsnr_track.detection_model import DetectionModel
from lowsnr_track.evidence import frame_evidence
from lowsnr_track.measurements import Measurements
from lowsnr_track.particles import equally_weighted
from lowsnr_track.pda_mmpf import PdaMmpf
from lowsnr_track.track_management import TrackLife
from lowsnr_track.tracks import Tracks
import numpy as np
import pytest
import scipy
from track.scenes import everything

BEFORE = Prediction(0.6, np.array([9.0, 6.0]), np.array([[0.7, 0.1], [0.1, 0.5]]))
MEAN, COV = np.array([9.3, 5.8]), np.array([[0.2, -0.04], [-0.04, 0.3]])


def posterior(prob, mean, cov, before):
    """Return the declaration of a detector with a posterior."""
    state, whole = np.full(4, np.nan), np.full((4, 4), np.nan)
    state[[0, 2]] = mean
    whole[np.ix_([0, 2], [0, 2])] = cov
    return Estimate(state, whole, prob, predicted=before)


def steady(place, prob=0.9, cov=0.3):
    """Return a declaration of which the frame says nothing new."""
    place, cov = np.array(place, dtype=float), cov * np.eye(2)
    return posterior(prob, place, cov, Prediction(prob, place, cov))


@pytest.fixture
def tracker():
    return PdaMmpf(
        rows=16, cols=24, frames_per_detection=3, particles=20_000, roughening=0.0,
        motion=MotionModes(turn_rates_deg_s=(0.0,), acceleration_density=0.0, max_speed_mps=1e-9),
        life=TrackLife(lifetime_s=1e9), detection=DetectionModel(probability=0.999))


def test_evidence_is_the_ratio_of_posterior_and_prediction(rng):
    measured = Measurements(
        MEAN[None], COV[None], np.array([0.9]),
        Prediction(np.array([0.6]), BEFORE.position[None], BEFORE.cov[None]))
    places = np.array([9.0, 6.0]) + rng.standard_normal((1, 50, 2))
    states = np.insert(places, [1, 2], 0.0, axis=2)
    particles = equally_weighted(states, np.zeros((1, 50), dtype=int))
    found = frame_evidence(measured).log_ratios(particles, np.array([[0]]))
    ratio = scipy.stats.multivariate_normal(MEAN, COV).logpdf(places[0]) - (
        scipy.stats.multivariate_normal(BEFORE.position, BEFORE.cov).logpdf(places[0]))
    assert found[0, 0] == pytest.approx(np.log(0.9 / 0.1) - np.log(0.6 / 0.4) + ratio)


def test_track_that_predicts_what_the_detector_does_has_its_posterior(tracker, rng):
    states = np.zeros((1, 20_000, 4))
    states[..., [0, 2]] = rng.multivariate_normal(BEFORE.position, BEFORE.cov, (1, 20_000))
    tracks = Tracks(
        equally_weighted(states, np.zeros((1, 20_000), dtype=int)), np.array([0.6]),
        np.zeros((1, 2)), np.zeros(1), np.array([1]), np.array([False]))
    state = replace(tracker.init(), stamp_s=0.0, next_id=2, tracks=tracks)
    _, output = tracker.step(state, [posterior(0.9, MEAN, COV, BEFORE)], 1.0, rng)
    (track,) = [item for item in everything(output) if item.id == '1']
    # P_D is not quite one.
    assert track.score == pytest.approx(0.9, abs=0.005)
    assert track.state[[0, 2]] == pytest.approx(MEAN, abs=0.02)
    assert track.cov[np.ix_([0, 2], [0, 2])] == pytest.approx(COV, abs=0.02)


def test_frames_that_say_nothing_new_change_no_existence(tracker, rng):
    tracker = replace(tracker, particles=2000)
    for soft in (True, False):
        state = tracker.init()
        for k in range(12):
            item = steady((9.0, 6.0), prob=0.8)
            item = item if soft else replace(item, predicted=None)
            state, output = tracker.step(state, [item], float(k), rng)
        (track,) = everything(output)
        if soft:
            assert track.score == pytest.approx(0.8, abs=0.02)
        else:  # taken as hits, the same posterior counts again and again
            assert track.score > 0.95


def test_new_track_has_the_existence_that_the_detector_states(tracker, rng):
    _, output = tracker.step(tracker.init(), [steady((9.0, 6.0), prob=0.37)], 0.0, rng)
    (track,) = everything(output)
    assert track.score == pytest.approx(0.37)
    assert not output.confirmed


def test_evidence_for_one_track_is_not_evidence_for_another_beside_it(tracker, rng):
    states = np.zeros((2, 20_000, 4))
    states[..., [0, 2]] = rng.multivariate_normal(BEFORE.position, BEFORE.cov, (2, 20_000))
    tracks = Tracks(
        equally_weighted(states, np.zeros((2, 20_000), dtype=int)), np.array([0.9, 0.1]),
        np.zeros((2, 2)), np.zeros(2), np.array([1, 2]), np.array([False, False]))
    tracker = replace(tracker, life=TrackLife(lifetime_s=1e9, merge_distance=0.0))
    state = replace(tracker.init(), stamp_s=0.0, next_id=3, tracks=tracks)
    before = replace(BEFORE, score=0.5)
    _, output = tracker.step(state, [posterior(0.95, MEAN, COV, before)], 1.0, rng)
    score = {item.id: item.score for item in everything(output)}
    assert score['1'] > 0.9
    assert score.get('2', 0.0) < 0.1  # alone it would have .68


def test_frame_without_declarations_is_a_miss_whatever_is_declared_elsewhere(tracker, rng):
    """A detector with a posterior declares no object that has ended."""
    scores = []
    for elsewhere in ([], [steady((20.0, 12.0), prob=1e-4)]):
        state = tracker.init()
        for k, items in enumerate([[steady((9.0, 6.0))]] * 3 + [elsewhere]):
            state, output = tracker.step(state, items, float(k), np.random.default_rng(k))
        assert not state.tracks.ended.any()
        scores.append([item.score for item in everything(output) if item.id == '1'])
    assert scores[0] == pytest.approx(scores[1])


@pytest.mark.filterwarnings('error')
def test_track_that_has_left_the_frame_is_dropped_beside_another(tracker, rng):
    states = np.zeros((1, 20_000, 4))
    states[..., 0], states[..., 1] = 23.0, 2.0  # beyond the last column in the next frame
    tracks = Tracks(
        equally_weighted(states, np.zeros((1, 20_000), dtype=int)), np.array([0.9]),
        np.zeros((1, 2)), np.zeros(1), np.array([1]), np.array([True]))
    state = replace(tracker.init(), stamp_s=0.0, next_id=2, tracks=tracks)
    _, output = tracker.step(state, [steady((9.0, 6.0))], 1.0, rng)
    assert [item.id for item in everything(output)] == ['2']


@pytest.mark.parametrize('predicted', [
    Prediction(0.5, np.array([np.nan, 6.0]), np.eye(2)),
    Prediction(1.5, np.array([9.0, 6.0]), np.eye(2)),
    Prediction(np.nan, np.array([9.0, 6.0]), np.eye(2)),
    Prediction(0.5, np.array([9.0, 6.0]), np.full((2, 2), np.nan)),
    Prediction(0.5, np.array([9.0, 6.0]), np.zeros((2, 2))),
    Prediction(0.5, np.array([9.0, 6.0]), np.array([[1.0, 2.0], [2.0, 1.0]])),
    Prediction(0.5, np.array([9.0, 6.0]), np.array([[1.0, 0.5], [0.0, 1.0]])),
    Prediction(0.5, np.array([9.0, 6.0]), np.diag([1e40, 1.0])),
    Prediction(0.5, np.array([1e300, 6.0]), np.eye(2)),
    None,
], ids=[
    'no place', 'no probability', 'not a number', 'no covariance', 'no error', 'not definite',
    'not symmetric', 'too large', 'too far', 'none'])
def test_prediction_that_cannot_be_used_leaves_hits(predicted):
    outputs = []
    for given in (predicted, None):
        tracker, rng = PdaMmpf(rows=16, cols=24, particles=50), np.random.default_rng(0)
        state = tracker.init()
        for k in range(3):
            declared = [
                replace(steady((9.0, 6.0)), predicted=given),
                steady((15.0, 6.0)) if given else replace(steady((15.0, 6.0)), predicted=None)]
            state, output = tracker.step(state, declared, float(k), rng)
        outputs.append(state.tracks)
    assert np.array_equal(outputs[0].particles.states, outputs[1].particles.states)
    assert np.array_equal(outputs[0].existence, outputs[1].existence)
