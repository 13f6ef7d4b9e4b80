# SPDX-License-Identifier: Apache-2.0
"""The tracker whose particles carry a destination each."""

from dataclasses import replace
import itertools

from lowsnr_bringup.plan.empty_tracks import of_run
from lowsnr_common.core.bound_motion import DestinationDensity
from lowsnr_common.core.bound_motion import Destinations
from lowsnr_common.core.bound_motion import UNBOUND
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import process_noise_cov
from lowsnr_common.core.motion import transition_matrix
from lowsnr_common.core.records import Truth
from lowsnr_detect.detectors.cdt import CDT
from lowsnr_eval.study.offline_chain import detect
from lowsnr_sensor.simulator import simulate_frames
from lowsnr_sensor.trajectories import random_trajectory
from lowsnr_track.detection_model import DetectionModel
from lowsnr_track.pda_mmpf import PdaMmpf
from lowsnr_track.track_management import TrackLife
import numpy as np
import pytest
from track.scenes import detection
from track.scenes import everything
from track.scenes import follow

SHAPE, LAST = (24, 32), 24
SEEN = 10  # the frames from which on there are no detections
MOTION = MotionModes(
    turn_rates_deg_s=(0.0,), acceleration_density=0.01, min_speed_mps=0.3, max_speed_mps=1.0)
PATIENT = TrackLife(lifetime_s=1e6, delete_probability=1e-6)
TO = Destinations(
    probability=(0.8, 0.2), x_m=(27.0, 25.0), y_m=(4.0, 20.0), std_m=(0.7, 0.7),
    earliest_frame=(LAST - 2, LAST - 2), latest_frame=(LAST, LAST))
PLAIN = PdaMmpf(
    rows=SHAPE[0], cols=SHAPE[1], motion=MOTION, life=PATIENT, particles=1000,
    detection=DetectionModel(probability=0.5, clutter_density=2e-6))
DETECTOR = CDT(sensor=SensorModel(snr_db=16.0), threshold=10.0)
BOUND = replace(PLAIN, destinations=TO)


def last_errors(run):
    """
    Return how far from the object the best track is at the end of a gap [m].

    The first is that of a tracker without destinations, the second that of one with them, behind
    the same detector on the same frames.
    """
    rng = np.random.default_rng(run)
    path = random_trajectory(
        MOTION, LAST, SHAPE[::-1], 1.0, 1.0, rng, destinations=TO.densities)
    objects = [[Truth('a', state, 0.0)] if k < SEEN else [] for k, state in enumerate(path)]
    frames = simulate_frames(objects, DETECTOR.sensor, SHAPE, rng)
    (answers,) = detect([DETECTOR], frames[None].astype(float), run, 0)
    found = [of_run(declared, 0) for declared in answers]
    errors = []
    for tracker in (PLAIN, BOUND):
        last = follow(tracker, found, np.random.default_rng(run))[-1]
        best = max(everything(last), key=lambda item: item.score)
        errors.append(np.linalg.norm(best.state[POS] - path[-1, POS]))
    return errors


def test_through_a_gap_it_ends_nearer_to_objects_that_are_bound_for_the_destinations():
    runs = 24
    gain = -np.diff([last_errors(run) for run in range(runs)], axis=1)
    assert gain.mean() - 1.96 * gain.std(ddof=1) / np.sqrt(runs) > 0.5


def test_particles_have_the_shares_and_the_arrivals_of_the_declaration(rng):
    """A detection without information leaves the particles to the motion alone."""
    certain = DestinationDensity(
        x_m=27.0, y_m=12.0, std_m=0.5, earliest_frame=6, latest_frame=6, probability=0.7)
    to = Destinations(**{name: (getattr(certain, name),) for name in TO.__dataclass_fields__})
    tracker = replace(BOUND, destinations=to, particles=20_000)
    state = tracker.init()
    for stamp_s in (10.0, 11.0, 13.0, 15.0):  # frames 1, 2, 4 and 6: two are lost
        found = [detection(23.0, 12.0, variance=0.09)] if stamp_s == 10.0 else []
        state, _ = tracker.step(state, found, stamp_s, rng)
    particles = state.tracks.particles
    assert state.frame(1.0) == 6
    arrived = particles.bound.arrival[0] != UNBOUND
    away = np.linalg.norm(particles.states[0, :, POS].T - particles.bound.place[0], axis=1)
    assert np.mean(arrived) == pytest.approx(0.7, abs=0.03)
    assert np.all(away[arrived] < 1e-9)


@pytest.mark.parametrize('intervals_s', [(1.0,), (0.5,), (0.6, 1.4), (0.7,), (4.0,)])
def test_particles_have_the_moments_of_the_motion_whatever_the_intervals(intervals_s, rng):
    arrival_s, place = 20.0, np.array([43.0, 12.0])
    to = Destinations(
        probability=(1.0,), x_m=(place[0],), y_m=(place[1],), std_m=(0.0,),
        earliest_frame=(1 + round(arrival_s),), latest_frame=(1 + round(arrival_s),))
    tracker = PdaMmpf(
        motion=MOTION, life=PATIENT, particles=20_000, destinations=to,
        detection=DetectionModel(probability=0.1, clutter_density=2e-6))
    first, _ = tracker.step(tracker.init(), [detection(23.0, 12.0, variance=0.09)], 100.0, rng)
    state, elapsed_s = first, 0.0
    for interval_s in itertools.cycle(intervals_s):
        if elapsed_s + interval_s > 12.0 + 1e-9:
            break
        elapsed_s += interval_s
        state, _ = tracker.step(state, [], 100.0 + elapsed_s, rng)
    # The joint Gaussian of the state at this time and the position at the arrival.
    origin, found = (each.tracks.particles.states[0] for each in (first, state))
    noise, rest = process_noise_cov(elapsed_s, 0.01), transition_matrix(arrival_s - elapsed_s)
    gain = (noise @ rest.T)[:, POS] / process_noise_cov(arrival_s, 0.01)[0, 0]
    of_origin = transition_matrix(elapsed_s) - gain @ transition_matrix(arrival_s)[POS]
    mean = of_origin @ origin.mean(axis=0) + gain @ place
    cov = of_origin @ np.cov(origin.T) @ of_origin.T + noise - gain @ (noise @ rest.T)[:, POS].T
    deviation = np.sqrt(np.diag(cov))
    assert np.all(abs(found.mean(axis=0) - mean) < 4.0 * deviation / np.sqrt(20_000))
    assert found.std(axis=0) == pytest.approx(deviation, rel=0.03)


def test_destinations_stay_in_the_scene_when_the_cells_move(rng):
    state, _ = BOUND.step(BOUND.init(), [detection(9, 8)], 1.0, rng)
    moved = state.moved((2, -3), 1.0)
    shift = moved.tracks.particles.bound.place - state.tracks.particles.bound.place
    on_the_way = state.tracks.particles.bound.arrival != UNBOUND
    assert on_the_way.any()
    assert np.allclose(shift[on_the_way], [3.0, -2.0])


def test_frames_are_counted_anew_after_a_cut(rng):
    state, _ = BOUND.step(BOUND.init(), [detection(9, 8)], 100.0, rng)
    state, _ = BOUND.step(state, [], 104.0, rng)
    assert state.frame(1.0) == 5
    state, _ = BOUND.step(BOUND.restart(state), [], 50.0, rng)
    assert state.frame(1.0) == 1
