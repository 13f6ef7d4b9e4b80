# SPDX-License-Identifier: Apache-2.0
"""The particle filter whose particles carry a destination each."""

from lowsnr_common.core.bound_motion import Destinations
from lowsnr_common.core.bound_motion import UNBOUND
from lowsnr_common.core.destination import Destination
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_detect.detectors.tbd2 import MMTBD2
from lowsnr_detect.parts.existence import Existence
from lowsnr_detect.parts.moved_memory import moved_memory
import numpy as np
import pytest

SENSOR = SensorModel(snr_db=16.0)
MOTION = MotionModes(
    turn_rates_deg_s=(0.0, 10.0, -10.0), acceleration_density=0.02, max_speed_mps=1.5)
STAYS = Existence(birth_prob=1e-6, death_prob=1e-6, initial_prob=0.5)
SHAPE, FIRST = (16, 24), (4, 5)  # rows and columns of a frame, and of the object at first
TO = Destinations(
    probability=(0.6, 0.3), x_m=(16.0, 5.0), y_m=(9.0, 13.0), std_m=(0.2, 0.2),
    earliest_frame=(9, 9), latest_frame=(9, 9))


def seen_once(detector, rng, frames, moves=()):
    """Return the memories and declarations: the object shows in the first two frames alone."""
    state, found = detector.init(SHAPE), []
    for number in range(1, frames + 1):
        for at, by in moves:
            if number == at:
                state = moved_memory(state, detector.init(SHAPE), SHAPE, by, 1.0)
        frame = np.full(SHAPE, SENSOR.intensity / 2.0)  # a likelihood ratio of one
        if number <= 2:
            frame = np.zeros(SHAPE)
            frame[FIRST] = SENSOR.intensity
        state, declared = detector.step(state, frame, rng)
        found.append((state, declared))
    return found


def test_particles_arrive_in_the_shares_of_the_destinations(rng):
    detector = MMTBD2(sensor=SENSOR, motion=MOTION, existence=STAYS, destinations=TO,
                      particles=8000, birth_particles=8000, threshold=-50.0)
    state, declared = seen_once(detector, rng, 9)[-1]
    place, bound = state.states[:, POS], state.bound
    for n, prob in enumerate(TO.probability):
        there = np.linalg.norm(place - (TO.x_m[n], TO.y_m[n]), axis=1) < 1.0
        own = (bound.arrival == 9) & (abs(bound.place[:, 0] - TO.x_m[n]) < 3.0)
        assert own.mean() == pytest.approx(prob, abs=0.06)
        assert np.all(there[own])
    assert np.mean(bound.arrival == UNBOUND) == pytest.approx(0.1, abs=0.04)
    # It has not been seen for long, and is declared where it must have arrived.
    assert declared.state[0, POS] == pytest.approx([16.0, 9.0], abs=0.3)
    assert declared.score[0] > 0.9


def test_time_of_arrival_is_learned_from_where_the_object_is(rng):
    # The object is seen where only one that arrives early can be.
    to = Destinations(probability=(1.0,), x_m=(16.0,), y_m=(4.0,), std_m=(0.1,),
                      earliest_frame=(8,), latest_frame=(20,))
    motion = MotionModes(turn_rates_deg_s=(0.0,), acceleration_density=0.001, max_speed_mps=2.0)
    detector = MMTBD2(sensor=SENSOR, motion=motion, existence=STAYS, destinations=to,
                      particles=6000, birth_particles=6000)
    state, before = detector.init(SHAPE), []
    for number in range(1, 7):
        frame = np.zeros(SHAPE)
        frame[4, round(5 + 11 / 7 * (number - 1))] = SENSOR.intensity
        state, _ = detector.step(state, frame, rng)
        before.append(float(np.mean(state.bound.arrival)))
    assert before[0] == pytest.approx(14.0, abs=0.5)
    assert before[-1] < 9.5


def test_destinations_stay_in_the_scene_when_the_cells_move(rng):
    detector = MMTBD2(sensor=SENSOR, motion=MOTION, existence=STAYS, destinations=TO,
                      particles=3000, birth_particles=3000, threshold=-50.0)
    _, declared = seen_once(detector, rng, 9, moves=[(5, (2, -3))])[-1]
    assert declared.state[0, POS] == pytest.approx([16.0 + 3.0, 9.0 - 2.0], abs=0.4)


def test_without_destinations_nothing_is_drawn_for_them():
    one, other = (MMTBD2(sensor=SENSOR, motion=MOTION, particles=500, birth_particles=500,
                         threshold=-50.0) for _ in range(2))
    found = [seen_once(each, np.random.default_rng(3), 4)[-1] for each in (one, other)]
    assert found[0][0].bound is None
    assert found[0][1].state.tobytes() == found[1][1].state.tobytes()


@pytest.mark.parametrize(('settings', 'word'), [
    ({'destination': Destination(probability=0.5)}, 'destination and destinations'),
    ({'motion': MotionModes(acceleration_density=0.0)}, 'acceleration_density')])
def test_settings_that_exclude_destinations_are_refused(settings, word):
    with pytest.raises(ValueError, match=word):
        MMTBD2(destinations=TO, **settings)


@pytest.mark.parametrize('values', [
    {'x_m': (1.0,)}, {'probability': (0.8, 0.3)}, {'latest_frame': (9, 8)}, {'std_m': (-1.0, 1)}])
def test_lists_that_do_not_fit_are_refused(values):
    whole = {name: getattr(TO, name) for name in TO.__dataclass_fields__}
    with pytest.raises(ValueError, match=next(iter(values))):
        Destinations(**whole | values)
