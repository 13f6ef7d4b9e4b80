# SPDX-License-Identifier: Apache-2.0
"""The whole tracker: existence against closed forms, and the life of tracks."""

from dataclasses import replace

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_track import measurements
from lowsnr_track.detection_model import DetectionModel
from lowsnr_track.pda_mmpf import PdaMmpf
from lowsnr_track.track_management import TrackLife
import numpy as np
import pytest
from track import oracles
from track.scenes import detection
from track.scenes import everything
from track.scenes import follow
from track.scenes import straight
from track.scenes import VARIANCE

PLAIN = DetectionModel(use_scores=False)


def at_birth(tracker):
    odds = tracker.detection.probability * tracker.life.birth_density
    return odds / (odds + tracker.detection.clutter_density)


@pytest.fixture
def tracker():
    return PdaMmpf(rows=16, cols=24, detection=PLAIN)


def test_object_is_confirmed_followed_and_dropped(tracker, rng):
    path = straight(15)
    frames = [[detection(*p)] for p in path] + [[]] * 15
    outputs = follow(tracker, frames, rng)
    assert not outputs[0].confirmed
    confirmed = [output.confirmed for output in outputs[3:15]]
    assert [len(tracks) for tracks in confirmed] == [1] * 12
    assert {tracks[0].id for tracks in confirmed} == {'1'}
    error = [tracks[0].state[[0, 2]] - p for tracks, p in zip(confirmed, path[3:])]
    assert np.max(np.abs(error)) < 3 * np.sqrt(VARIANCE)
    assert outputs[14].confirmed[0].state[[1, 3]] == pytest.approx([0.5, 0.2], abs=0.2)
    assert not everything(outputs[-1])


def test_existence_of_missed_object_matches_closed_form(tracker, rng):
    outputs = follow(replace(tracker, particles=100), [[detection(9, 8)], []], rng)
    missed = 1 - tracker.detection.in_gate_probability
    survival = np.exp(-1 / tracker.life.lifetime_s)
    expected = at_birth(tracker)
    for output in outputs:
        assert everything(output)[0].score == pytest.approx(expected)
        expected *= survival
        expected = expected * missed / (1 - expected + expected * missed)


def test_existence_and_state_match_exact_integrated_pda(rng):
    """One mode, velocity all but known: the posterior is a mixture of Kalman filters."""
    motion = MotionModes(
        turn_rates_deg_s=(0.0,), min_speed_mps=0.0, max_speed_mps=1e-9,
        acceleration_density=0.02)
    tracker = PdaMmpf(
        motion=motion, particles=100_000, detection=PLAIN,
        life=TrackLife(lifetime_s=40.0, max_tracks=1))
    frames = [[(5.0, 6.0)], [(5.4, 6.3), (4.2, 5.9)], [], [(5.5, 6.5), (6.0, 5.0)]]
    outputs = follow(tracker, [[detection(*z) for z in frame] for frame in frames], rng)
    mixture = oracles.gaussian(
        np.array([5.0, 0, 6.0, 0]), np.diag([VARIANCE, 1e-18, VARIANCE, 1e-18]), 1)
    existence = at_birth(tracker)
    noise = motion_noise(motion)
    for frame, output in zip(frames[1:], outputs[1:]):
        mixture = oracles.predict(
            mixture, motion.transition_matrices(1.0), noise, np.ones((1, 1)))
        mixture, gain = oracles.update(
            mixture, frame, VARIANCE * np.eye(2),
            PLAIN.in_gate_probability, PLAIN.clutter_density)
        existence *= np.exp(-1 / tracker.life.lifetime_s)
        existence = existence * gain / (1 - existence + existence * gain)
        track = min(everything(output), key=lambda item: int(item.id))
        mean, cov = mixture.moments()
        # Effective sizes stay above a tenth of the particles: five standard errors.
        error = 5 * np.sqrt(10 / tracker.particles)
        std = np.sqrt(np.diag(cov))
        assert np.all(abs(track.state - mean) < error * std)
        assert np.all(abs(track.cov - cov) < 2 * error * np.outer(std, std))
        assert track.score == pytest.approx(existence, abs=error * existence * (1 - existence))


def motion_noise(motion):
    step = motion.acceleration_density * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])
    return np.kron(np.eye(2), step)


def test_false_detections_that_share_frames_may_be_repeated(tracker):
    """The gain is that of Bayes' rule against "false, repeated with probability q"."""
    gains, model = {}, tracker.detection
    for frames in (1, 4):
        settings = replace(
            tracker, frames_per_detection=frames, life=TrackLife(lifetime_s=1e12))
        for name, then in (('seen', [detection(9, 8)]), ('missed', [])):
            outputs = follow(settings, [[detection(9, 8)], then], np.random.default_rng(1))
            score = np.array([everything(output)[0].score for output in outputs])
            gains[name, frames] = np.exp(np.diff(np.log(score / (1 - score)))[0])
    missed, q = 1 - model.in_gate_probability, model.repeated
    assert gains['missed', 1] == pytest.approx(missed)
    assert gains['missed', 4] == pytest.approx(missed / (1 - q))
    seen = gains['seen', 1]
    repeated = (seen - missed) / model.in_gate_probability
    assert gains['seen', 4] == pytest.approx(seen / (1 - q + q * repeated))


def test_falling_scores_and_a_miss_end_a_track_sooner_where_detections_share_frames(rng):
    """Declarations of an object that has gone say less and less that it exists."""
    path = straight(15)
    alive = [[detection(*p, score=0.9999)] for p in path[:11]]
    fading = [[detection(*p, score=score)] for p, score in zip(path[11:], (0.99, 0.9, 0.7))]
    existence = {}
    for frames in (1, 5):
        tracker = PdaMmpf(
            rows=16, cols=24, sensor=SensorModel(snr_db=9.0), frames_per_detection=frames,
            particles=500)
        outputs = follow(tracker, alive + fading + [[]], rng)
        assert {item.id for output in outputs for item in everything(output)} == {'1'}
        existence[frames] = [sum(item.score for item in output.confirmed) for output in outputs]
    assert min(existence[1][10:14]) > 0.99
    assert existence[1][14] > 0.5
    assert existence[5][10] > 0.95
    assert np.all(np.diff(existence[5][10:]) < 0.0)
    assert existence[5][14] == 0.0  # released


def test_two_crossing_objects_keep_their_ids(rng):
    tracker = PdaMmpf(
        rows=20, cols=20, detection=DetectionModel(probability=0.95, use_scores=False))
    first = straight(24, (2.0, 6.0), (0.6, 0.3))
    second = straight(24, (2.0, 13.0), (0.6, -0.3))
    frames = [[detection(*p, variance=0.1) for p in pair] for pair in zip(first, second)]
    outputs = follow(tracker, frames, rng)
    ends = {item.id: item.state[2] for item in outputs[-1].confirmed}
    starts = {item.id: item.state[2] for item in outputs[4].confirmed}
    assert sorted(ends) == sorted(starts) == ['1', '2']
    assert all((starts[name] < 10) == (ends[name] > 10) for name in starts)


def test_two_tracks_on_one_object_become_one(tracker, rng):
    """A second detection in every early frame starts a second track."""
    path = straight(16)
    frames = [[detection(*p), detection(*(p + [0.3, 1.0]))] for p in path[:6]]
    frames += [[detection(*p)] for p in path[6:]]
    outputs = follow(tracker, frames, rng)
    assert len(outputs[-1].confirmed) == 1
    assert outputs[-1].confirmed[0].id in {item.id for item in outputs[5].confirmed}


def test_track_that_leaves_the_frame_is_deleted(tracker, rng):
    path = straight(20, (16.0, 8.0), (0.9, 0.0))
    frames = [[detection(*p)] if p[0] < 23.5 else [] for p in path]
    outputs = follow(tracker, frames, rng)
    assert outputs[7].confirmed
    assert not outputs[-1].confirmed


def test_release_has_hysteresis(tracker, rng):
    tracker = replace(
        tracker, life=TrackLife(confirm_probability=0.95, release_probability=0.5),
        detection=replace(PLAIN, probability=0.8))
    frames = [[detection(*p)] for p in straight(6)] + [[], [], [], []]
    outputs = follow(tracker, frames, rng)
    score = [everything(output)[0].score for output in outputs]
    released, confirmed = tracker.life.release_probability, tracker.life.confirm_probability
    assert released < score[6] < confirmed
    assert outputs[6].confirmed
    assert score[-1] < released
    assert not outputs[-1].confirmed


def test_uneven_stamps_are_followed(tracker, rng):
    times = np.cumsum([1.0, 0.5, 2.0, 1.0, 1.7, 0.4, 1.0, 3.0, 1.0])
    state = tracker.init()
    for t in times:
        state, output = tracker.step(state, [detection(3 + 0.6 * t, 4 + 0.3 * t)], t, rng)
    assert output.confirmed[0].state == pytest.approx(
        [3 + 0.6 * t, 0.6, 4 + 0.3 * t, 0.3], abs=0.8)


def test_same_seed_same_tracks(tracker):
    frames = [[detection(*p), detection(12, 3)] for p in straight(8)]
    one, two = (follow(tracker, frames, np.random.default_rng(3)) for _ in range(2))
    for a, b in zip(one, two):
        assert [item.id for item in everything(a)] == [item.id for item in everything(b)]
        assert all(np.array_equal(p.state, q.state) and p.score == q.score
                   for p, q in zip(everything(a), everything(b)))


def test_axes_are_not_swapped():
    sensor = SensorModel(cell_size_m=2.0)
    tracker = PdaMmpf(sensor=sensor, rows=5, cols=7)
    rng = np.random.default_rng(1)
    _, output = tracker.step(tracker.init(), [detection(12.5, 0), detection(0, 12.5)], 1.0, rng)
    assert output.rejected == {measurements.OUTSIDE: 1}
    assert everything(output)[0].state[0] == pytest.approx(12.5, abs=0.2)


def test_thresholds_in_the_wrong_order_are_rejected():
    with pytest.raises(ValueError, match='release_'):
        TrackLife(confirm_probability=0.2)
