"""Scenario files: what they mean, and one line for everything that can be wrong in them."""

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


def test_object_that_noise_drives_out_is_absent(load, rng):
    scenario = load(f'acceleration_density: 4.0\n{LEGS}')
    for _ in range(20):
        for objects in scenario.truth(1.0, 1.0, rng):
            for item in objects:
                assert np.all(item.state[POS] >= -0.5)
                assert np.all(item.state[POS] < [4.5, 6.5])


def test_cell_size_decides_what_lies_in_the_frame(load):
    assert load(LEGS, cell_size_m=2.0).shape == (7, 5)
    with pytest.raises(ValueError, match='object a leaves the frame at frame 7'):
        load(LEGS, cell_size_m=0.6)


BAD = [
    ('rows: 0', ['rows = 0', 'a whole number in [1, 16384]']),
    ('rows: 7.5', ['rows = 7.5', 'a whole number']),
    ('frames: ' + '{' * 3000, ['not YAML']),
    ('objects: [{id: "", last_frame: 1}]', ['objects[0]', 'id is empty']),
    ('snrs_db: [900.0]', ['snrs_db = [900.0]', '[-30.0, 80.0]']),
    (LEGS.replace('first_frame: 3', 'first_frame: 7'),
     ['objects[0]', 'increase from first_frame']),
    (LEGS.replace('frames: 12', 'frames: 4'), ['object b: first_frame = 8', 'frames = 4']),
    ('frames: many', ["frames = 'many'", 'a whole number in [1, 1000000]']),
    ('snr_db: loud', ["snr_db = 'loud'", 'a number in [-30.0, 80.0]']),
    ('snr_db: .nan', ['snr_db = nan', 'a number in']),
    ('snr_db: 90', ['snr_db = 90', '[-30.0, 80.0]']),
    ('snrs_db: 6', ['snrs_db = 6', 'a list of numbers']),
    ('sn_db: 6.0', ['sn_db is not a setting', 'did you mean snr_db?']),
    ('7: 6.0', ['7 is not a setting']),
    ('objects: {id: a}', ['objects must be a list']),
    ('objects: [3]', ['objects[0] must be a mapping']),
    ('objects: [{id: a}]', ['objects[0]', 'one of legs, waypoints and random']),
    ('- 3', ['the file must be a mapping']),
    ('', ['the file must be a mapping']),
    ('rows: [', ['not YAML']),
    ('rows: !!python/object:os.system {}', ['not YAML']),
    (LEGS.replace('speed_mps: 0.5}', 'speed_mps: -0.5}'),
     ['objects[0].legs[0]', 'speed_mps = -0.5', 'a number in [0.0, inf)']),
    (LEGS.replace('turn_rate_deg_s', 'turn_rate'),
     ['objects[0].legs[1]', 'turn_rate is not a setting', 'did you mean turn_rate_deg_s?']),
    (LEGS.replace('heading_deg: 90.0', 'heading_deg: north'),
     ['objects[0].start', "heading_deg = 'north'", 'a number in [-360.0, 360.0]']),
    (LEGS.replace('start:', 'starts:'), ['objects[0]', 'starts is not a setting']),
    (LEGS.replace('id: b', 'id: a'), ['different ids']),
    (LEGS.replace('first_frame: 3', 'first_frame: 10'),
     ['objects[0]', 'last_frame = 9, must be at least first_frame']),
    (LEGS.replace('last_frame: 9', 'last_frame: 10'),
     ['objects[0]', 'must end at last_frame 10']),
    (LEGS.replace('until_frame: 6', 'until_frame: 9'), ['objects[0]', 'must increase']),
    (LEGS.replace('frame: 8, x', 'frame: 9, x'), ['objects[1]', 'the first at first_frame']),
    (LEGS.replace('frame: 12, x_m: 2.0', 'frame: 12, x_m: 5.0'),
     ['object b leaves the frame at frame 10', 'column 4.5', 'of 5 x 7 cells']),
    (LEGS.replace('y_m: 2.0', 'y_m: -0.6'), ['object a leaves the frame at frame 3', 'row -0.6']),
    (RANDOM.replace('random: {', 'random: {turn_rates_deg_s: [], '),
     ['objects[0].random', 'turn_rates_deg_s', 'at least one mode']),
    (RANDOM.replace('max_speed_mps: 0.4', 'max_speed_mps: 0.0'),
     ['objects[0].random', 'max_speed_mps = 0.0', 'a number in (0.0, inf)']),
    (RANDOM.replace('random: {', 'legs: [], random: {speed: 1.0, '),
     ['objects[0].random', 'speed is not a setting']),
]


@pytest.mark.parametrize(('text', 'parts'), BAD, ids=range(len(BAD)))
def test_bad_file_is_refused_in_one_line(text, parts, load, tmp_path):
    with pytest.raises(ValueError) as caught:
        load(text)
    message = str(caught.value)
    assert message.startswith(f'{tmp_path / "scenario.yaml"}: ')
    assert '\n' not in message
    assert [part for part in parts if part not in message] == []


def test_missing_file_is_refused_in_one_line(tmp_path):
    path = tmp_path / 'none.yaml'
    with pytest.raises(ValueError) as caught:
        load_scenario(path)
    assert str(caught.value) == f'{path}: cannot be read: No such file or directory'


def test_folder_and_binary_file_are_refused(tmp_path):
    with pytest.raises(ValueError, match='cannot be read: Is a directory'):
        load_scenario(tmp_path)
    path = tmp_path / 'noise.yaml'
    path.write_bytes(bytes(range(256)))
    with pytest.raises(ValueError, match=r'noise\.yaml: is not YAML'):
        load_scenario(path)


@pytest.mark.parametrize(('change', 'said'), [
    (('last_frame: 12', 'last_frame: 1000000000000'), 'last_frame = 1000000000000'),
    (('last_frame: 12', 'last_frame: 999999'), 'must be of at most 10000'),
])
def test_what_would_never_end_is_refused(tmp_path, change, said):
    path = tmp_path / 'endless.yaml'
    path.write_text(RANDOM.replace(*change))
    with pytest.raises(ValueError, match=said):
        load_scenario(path)
