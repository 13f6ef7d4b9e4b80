# SPDX-License-Identifier: Apache-2.0
"""Grid filters of objects that are bound for destinations: where they expect an object."""

from lowsnr_bringup.plan.frame_checks import check_detector
from lowsnr_common.core.bound_motion import Destinations
from lowsnr_common.core.bound_motion import draw_bound
from lowsnr_common.core.bound_motion import move_bound
from lowsnr_common.core.destination import Destination
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_detect.detectors.hmm import HMM
from lowsnr_detect.detectors.pmf import PMF
from lowsnr_detect.grid.fixed_lag import answers
from lowsnr_detect.parts.existence import Existence
from lowsnr_detect.parts.moved_memory import moved_memory
import numpy as np
import pytest

FILTERS = {'hmm': HMM, 'pmf': PMF}
BRIGHT = SensorModel(snr_db=16.0)
STAYS = Existence(birth_prob=1e-6, death_prob=1e-6, initial_prob=0.5)
GENTLE = MotionModes(turn_rates_deg_s=(0.0,), acceleration_density=0.1, max_speed_mps=1.5)
PLACES = Destinations(
    probability=(0.5, 0.3), x_m=(3.5, 0.4), y_m=(1.5, 2.2), std_m=(0.4, 0.9),
    earliest_frame=(3, 4), latest_frame=(4, 4))
SHAPE, FIRST = (16, 24), (4, 5)  # rows and columns of a frame, and of the object at first


def one_place(**settings):
    """Return one destination that all objects are bound for."""
    values = {'probability': 1.0, 'x_m': 14.0, 'y_m': 9.0, 'std_m': 0.2, 'earliest_frame': 10,
              'latest_frame': 10} | settings
    return Destinations(**{key: (value,) for key, value in values.items()})


def beliefs_of(detector, cells, moves=()):
    """Return all beliefs; the object shows in ``cells``, those of the first frames, alone."""
    state, found = detector.init(SHAPE), []
    for number in range(1, 12):
        for at, by in moves:
            if number == at:
                state = moved_memory(state, detector.init(SHAPE), SHAPE, by, 1.0)
        frame = np.full(SHAPE, BRIGHT.intensity / 2.0)  # a likelihood ratio of one
        if number <= len(cells):
            frame = np.zeros(SHAPE)
            frame[tuple(cells[number - 1])] = 2.0 * BRIGHT.intensity
        state, _ = detector.step(state, frame, None)
        found.append(state[-1])
    return found


def pair_shares(belief):
    """Return the probability to be bound for none and each pair ahead."""
    if hasattr(belief, 'weights'):
        return belief.weights.sum(axis=(0, 1, 3, 4)) / belief.mass
    return (belief.planes * belief.scale).sum(axis=(0, 2, 3))


def mean_place(detector, belief):
    """Return the mean column and row of the object."""
    mass = belief.mass if isinstance(detector, PMF) else belief.weights.sum(axis=(0, 1, 2))
    points = (np.indices(mass.shape) + 0.5) / getattr(detector, 'resolution', 1) - 0.5
    return (points[::-1] * mass).sum(axis=(1, 2)) / mass.sum()


@pytest.mark.parametrize('name', FILTERS)
def test_it_goes_where_particles_that_carry_a_destination_go(name):
    detector = FILTERS[name](
        sensor=BRIGHT, motion=GENTLE, existence=STAYS, destinations=one_place())
    rng, count = np.random.default_rng(0), 20_000
    states = np.zeros((count, 4))
    states[:, POS] = FIRST[::-1] + rng.uniform(-0.5, 0.5, (count, 2))
    states[:, VEL] = GENTLE.draw_velocity((count,), rng)
    bound = draw_bound(one_place().densities, (count,), rng)
    for number, belief in enumerate(beliefs_of(detector, [FIRST]), start=1):
        if number > 1:
            states = move_bound(GENTLE, states, np.zeros(count, int), bound.place,
                                bound.left_s(number, 1.0), 1.0, rng)
        # Cells and bounded speeds cost some tenths of a cell of the ten on the way.
        assert mean_place(detector, belief) == pytest.approx(
            states[:, POS].mean(axis=0), abs=1.2 if number > 10 else 0.8)


@pytest.mark.parametrize('name', FILTERS)
def test_pairs_keep_their_shares_where_frames_say_nothing(name):
    to = Destinations(probability=(0.6, 0.3), x_m=(14.0, 8.0), y_m=(9.0, 8.0), std_m=(0.2, 0.2),
                      earliest_frame=(8, 9), latest_frame=(11, 9))
    detector = FILTERS[name](sensor=BRIGHT, motion=GENTLE, existence=STAYS, destinations=to)
    found = beliefs_of(detector, [FIRST])
    for number, none, ahead in (
            (1, 0.1, [0.15, 0.15, 0.15, 0.15, 0.3]), (9, 0.25, [0.15, 0.15, 0.15, 0.3]),
            (10, 0.7, [0.15, 0.15]), (11, 0.85, [0.15])):
        shares = pair_shares(found[number - 1])
        # Up to a half of the tenth bound for none have left the frame, and count no more.
        assert none - 0.05 < shares[0] < none + 0.01
        assert np.sort(shares[1:]) == pytest.approx(ahead, abs=0.02)


@pytest.mark.parametrize('name', FILTERS)
def test_time_of_arrival_is_learned_from_where_the_object_is(name):
    to = one_place(x_m=16.0, y_m=4.0, std_m=0.1, earliest_frame=8, latest_frame=20)
    motion = MotionModes(turn_rates_deg_s=(0.0,), acceleration_density=0.02, max_speed_mps=2.0)
    detector = FILTERS[name](sensor=BRIGHT, motion=motion, existence=STAYS, destinations=to)
    cells = [(4, round(5 + 11 / 7 * number)) for number in range(6)]
    found = beliefs_of(detector, cells)
    arrival = np.array([0, *range(20, 7, -1)])
    assert pair_shares(found[0]) @ arrival == pytest.approx(14.0)
    assert pair_shares(found[5]) @ arrival < 9.5


@pytest.mark.parametrize('name', FILTERS)
def test_destinations_stay_in_the_scene_when_the_cells_move(name):
    detector = FILTERS[name](
        sensor=BRIGHT, motion=GENTLE, existence=STAYS, destinations=one_place())
    still, moved = (beliefs_of(detector, [FIRST], moves)[9] for moves in ((), [(5, (2, -3))]))
    assert mean_place(detector, moved) == pytest.approx(
        mean_place(detector, still) + (3.0, -2.0), abs=0.3)


@pytest.mark.parametrize('name', FILTERS)
def test_a_destination_that_cannot_be_reached_leaves_numbers(name):
    to = one_place(x_m=23.0, y_m=15.0, std_m=0.0, earliest_frame=2, latest_frame=3)
    detector = FILTERS[name](sensor=BRIGHT, motion=MotionModes(), destinations=to, lag=3)
    frames = np.zeros((6, *SHAPE))
    frames[:, 1, 2] = BRIGHT.intensity
    for declared in answers(detector, frames, None):
        assert declared.score[0] > 0.9
        assert declared.state[0, POS] == pytest.approx([2.0, 1.0], abs=0.5)


@pytest.mark.parametrize(('name', 'settings', 'word'), [
    ('hmm', {'destination': Destination(probability=0.5)}, 'destination and destinations'),
    ('hmm', {'motion': MotionModes(acceleration_density=0.0)}, 'acceleration_density'),
    ('pmf', {'motion': MotionModes(acceleration_density=0.0)}, 'acceleration_density')])
def test_settings_that_exclude_destinations_are_refused(name, settings, word):
    with pytest.raises(ValueError, match=word):
        FILTERS[name](destinations=PLACES, **settings)


@pytest.mark.parametrize('name', FILTERS)
def test_memory_grows_with_what_an_object_may_be_bound_for(name):
    plain, bound = FILTERS[name](), FILTERS[name](destinations=PLACES)
    assert bound.state_planes == 4 * plain.state_planes
    assert bound.memory_bytes(SHAPE) > 4 * plain.memory_bytes(SHAPE)


@pytest.mark.parametrize('name', FILTERS)
def test_pairs_beyond_all_memory_are_counted_without_being_made(name):
    last = 10**15
    bound = FILTERS[name](destinations=one_place(latest_frame=last))
    assert bound.state_planes == (1 + last - 9) * FILTERS[name]().state_planes
    with pytest.raises(ValueError, match='GiB'):
        check_detector(name, bound, {'rows': SHAPE[0], 'cols': SHAPE[1]})
