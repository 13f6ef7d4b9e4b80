# SPDX-License-Identifier: Apache-2.0
"""Scenario files: their meaning, and one line that names each fault."""

import errno
import os

from lowsnr_common.core.motion import POS
from lowsnr_sensor.scenario import load_scenario
import numpy as np
import pytest

LEGS = """
frames: 12
rows: 7
cols: 5
objects:
  - id: a
    first_frame: 3
    last_frame: 9
    start: {x_m: 1.0, y_m: 2.0, heading_deg: 90.0}
    legs:
      - {until_frame: 6, speed_mps: 0.5}
      - {until_frame: 9, speed_mps: 0.5, turn_rate_deg_s: 10.0}
  - id: b
    first_frame: 8
    last_frame: 12
    snr_offset_db: -2.0
    waypoints:
      - {frame: 8, x_m: 4.0, y_m: 1.0}
      - {frame: 12, x_m: 2.0, y_m: 1.0}
"""
RANDOM = """
rows: 7
cols: 5
objects:
  - {first_frame: 5, last_frame: 12, random: {min_speed_mps: 0.1, max_speed_mps: 0.4}}
"""
BOUND = """
rows: 30
cols: 40
frames: 30
objects:
  - first_frame: 3
    last_frame: 25
    random: {min_speed_mps: 0.1, max_speed_mps: 2.5, acceleration_density: 0.02}
    origin: {x_m: 4.0, y_m: 25.0, std_m: 0.5}
    destinations:
      - {x_m: 30.0, y_m: 5.0, std_m: 0.0, probability: 0.5, earliest_frame: 20, latest_frame: 24}
      - {x_m: 8.0, y_m: 5.0, std_m: 0.0, probability: 0.3, earliest_frame: 25, latest_frame: 25}
"""


@pytest.fixture
def load(tmp_path):
    """Return a function that loads a scenario from its text."""
    def from_text(text, **kwargs):
        path = tmp_path / 'scenario.yaml'
        path.write_text(text, encoding='utf-8')
        return load_scenario(path, **kwargs)

    return from_text


def test_objects_are_present_in_their_frames(load, rng):
    scenario = load(LEGS)
    truth = scenario.truth(1.0, 1.0, rng)
    assert scenario.shape == (7, 5)
    ids = [[item.id for item in objects] for objects in truth]
    assert ids == 2 * [[]] + 5 * [['a']] + 2 * [['a', 'b']] + 3 * [['b']]
    np.testing.assert_allclose(truth[2][0].state[POS], [1.0, 2.0])
    np.testing.assert_allclose(truth[5][0].state[POS], [1.0, 3.5])
    np.testing.assert_allclose(truth[9][0].state, [3.0, -0.5, 1.0, 0.0])
    assert truth[9][0].snr_offset_db == -2.0


def test_shorter_run_ends_the_objects(load, rng):
    truth = load(LEGS.replace('frames: 12', 'frames: 9')).truth(1.0, 1.0, rng)
    assert [len(objects) for objects in truth] == [0, 0, 1, 1, 1, 1, 1, 2, 2]


def test_no_objects_is_a_scenario(load, rng):
    assert load('frames: 3').truth(1.0, 1.0, rng) == [[], [], []]


def test_random_object_follows_the_generator(load):
    scenario = load(RANDOM)

    def states(seed):
        truth = scenario.truth(1.0, 1.0, np.random.default_rng(seed))
        return np.array([item.state for objects in truth for item in objects])

    np.testing.assert_array_equal(states(1), states(1))
    assert not np.array_equal(states(1), states(2))


def test_random_object_moves_from_its_origin_to_one_of_its_destinations(load):
    scenario, ends = load(BOUND), []
    for seed in range(100):
        truth = scenario.truth(1.0, 1.0, np.random.default_rng(seed))
        places = np.array([objects[0].state[POS] for objects in truth[2:25]])
        assert np.linalg.norm(places[0] - (4.0, 25.0)) < 3.0
        ends.append([float(abs(places[frames] - place).max(axis=1).min()) < 1e-9
                     for frames, place in ((slice(17, 22), (30.0, 5.0)), ([22], (8.0, 5.0)))])
    one, other = np.mean(ends, axis=0)
    assert not np.any(np.all(ends, axis=1))
    # Four standard errors; what does not fit into the frame changes no share.
    assert one == pytest.approx(0.5, abs=0.2)
    assert other == pytest.approx(0.3, abs=0.18)


def test_object_that_noise_moves_out_of_the_frame_is_absent(load, rng):
    scenario = load(f'acceleration_density: 4.0\n{LEGS}')
    for _ in range(20):
        for objects in scenario.truth(1.0, 1.0, rng):
            for item in objects:
                assert np.all(item.state[POS] >= -0.5)
                assert np.all(item.state[POS] < [4.5, 6.5])


def test_cell_size_determines_the_extent_of_the_frame(load):
    assert load(LEGS, cell_size_m=2.0).shape == (7, 5)
    with pytest.raises(ValueError, match='object a .*frame 7'):
        load(LEGS, cell_size_m=0.6)


# Each with the keys, values and bounds that the error must name.
BAD = [
    ('rows: 0', ['rows = 0', '16384']),
    ('rows: 7.5', ['rows = 7.5']),
    ('frames: ' + '{' * 3000, []),
    ('objects: [{id: "", last_frame: 1}]', ['objects[0]', 'id']),
    ('snrs_db: [900.0]', ['snrs_db', '900.0', '80.0']),
    (LEGS.replace('first_frame: 3', 'first_frame: 7'), ['objects[0]', 'first_frame']),
    (LEGS.replace('frames: 12', 'frames: 4'), ['object b', 'first_frame = 8', 'frames = 4']),
    ('frames: many', ["frames = 'many'", '1000000']),
    ('snr_db: loud', ["snr_db = 'loud'", '-30.0', '80.0']),
    ('snr_db: .nan', ['snr_db = nan']),
    ('snr_db: 90', ['snr_db = 90', '80.0']),
    ('snrs_db: 6', ['snrs_db = 6']),
    ('sn_db: 6.0', ['sn_db', 'snr_db']),
    ('7: 6.0', ['7']),
    ('objects: {id: a}', ['objects']),
    ('objects: [3]', ['objects[0]']),
    ('objects: [{id: a}]', ['objects[0]', 'legs', 'waypoints', 'random']),
    ('- 3', []),
    ('', []),
    ('rows: [', []),
    ('rows: !!python/object:os.system {}', []),
    (LEGS.replace('speed_mps: 0.5}', 'speed_mps: -0.5}'),
     ['objects[0].legs[0]', 'speed_mps = -0.5', '0.0']),
    (LEGS.replace('turn_rate_deg_s', 'turn_rate'),
     ['objects[0].legs[1]', 'turn_rate ', 'turn_rate_deg_s']),
    (LEGS.replace('heading_deg: 90.0', 'heading_deg: north'),
     ['objects[0].start', "heading_deg = 'north'", '360.0']),
    (LEGS.replace('start:', 'starts:'), ['objects[0]', 'starts']),
    (LEGS.replace('id: b', 'id: a'), ['objects', "['a', 'a']"]),
    (LEGS.replace('first_frame: 3', 'first_frame: 10'), ['objects[0]', 'last_frame = 9']),
    (LEGS.replace('last_frame: 9', 'last_frame: 10'), ['objects[0]', 'last_frame', '10']),
    (LEGS.replace('until_frame: 6', 'until_frame: 9'), ['objects[0]', 'legs']),
    (LEGS.replace('frame: 8, x', 'frame: 9, x'), ['objects[1]', 'waypoints', 'first_frame']),
    (LEGS.replace('frame: 12, x_m: 2.0', 'frame: 12, x_m: 5.0'),
     ['object b', 'frame 10', '4.5', '5 x 7']),
    (LEGS.replace('y_m: 2.0', 'y_m: -0.6'), ['object a', 'frame 3', '-0.6']),
    (RANDOM.replace('random: {', 'random: {turn_rates_deg_s: [], '),
     ['objects[0].random', 'turn_rates_deg_s']),
    (RANDOM.replace('max_speed_mps: 0.4', 'max_speed_mps: 0.0'),
     ['objects[0].random', 'max_speed_mps = 0.0']),
    (BOUND.replace('x_m: 30.0', 'x_m: 40.0'), ['destinations[0]', '40.0', '40 x 30']),
    (BOUND.replace('y_m: 25.0', 'y_m: 29.6'), ['object', 'origin', 'row 29.6', '40 x 30']),
    (BOUND.replace('x_m: 4.0', 'x_m: -0.6'), ['object', 'origin', 'column -0.6', '40 x 30']),
    (BOUND.replace('probability: 0.5', 'probability: 0.8'), ['objects[0]', 'probability', '1']),
    (BOUND.replace('earliest_frame: 25', 'earliest_frame: 3').replace(
        'latest_frame: 25', 'latest_frame: 9'),
     ['destinations[1]', 'earliest_frame = 3', 'first_frame']),
    (BOUND.replace('latest_frame: 24', 'latest_frame: 19'),
     ['objects[0].destinations[0]', 'latest_frame = 19', '20']),
    (BOUND.replace(', acceleration_density: 0.02', ', acceleration_density: 0'),
     ['objects[0]', 'acceleration_density', 'above 0']),
    (LEGS.replace('    legs:', '    origin: {}\n    legs:'), ['objects[0]', 'origin', 'random']),
    (RANDOM.replace('random: {', 'legs: [], random: {speed: 1.0, '),
     ['objects[0].random', 'speed']),
]


@pytest.mark.parametrize(('text', 'parts'), BAD, ids=range(len(BAD)))
def test_bad_file_is_rejected_in_one_line(text, parts, load, tmp_path):
    with pytest.raises(ValueError) as caught:
        load(text)
    message = str(caught.value)
    assert message.startswith(f'{tmp_path / "scenario.yaml"}: ')
    assert '\n' not in message
    assert [part for part in parts if part not in message] == []


def test_missing_file_is_named_with_the_cause(tmp_path):
    path = tmp_path / 'none.yaml'
    with pytest.raises(ValueError) as caught:
        load_scenario(path)
    assert str(caught.value).startswith(f'{path}: ')
    assert os.strerror(errno.ENOENT) in str(caught.value)


def test_folder_and_binary_file_are_rejected(tmp_path):
    with pytest.raises(ValueError, match=os.strerror(errno.EISDIR)):
        load_scenario(tmp_path)
    path = tmp_path / 'noise.yaml'
    path.write_bytes(bytes(range(256)))
    with pytest.raises(ValueError, match=r'noise\.yaml'):
        load_scenario(path)


@pytest.mark.parametrize(('last_frame', 'named'), [
    (1_000_000_000_000, 'last_frame = 1000000000000'), (999_999, '10000'),
])
def test_endless_object_is_rejected(tmp_path, last_frame, named):
    path = tmp_path / 'endless.yaml'
    path.write_text(RANDOM.replace('last_frame: 12', f'last_frame: {last_frame}'))
    with pytest.raises(ValueError, match=named):
        load_scenario(path)
