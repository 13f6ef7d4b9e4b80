# SPDX-License-Identifier: Apache-2.0
"""The scenarios of config/scenarios agree with the text of Section VI."""

from pathlib import Path

from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_sensor.scenario import load_scenario
import numpy as np
import pytest

FOLDER = Path(__file__).resolve().parents[2] / 'config' / 'scenarios'
NAMES = [path.stem for path in sorted(FOLDER.glob('*.yaml'))]
# First frame, last frame and SNRs of Section VI.
PAPER = {
    'example1': (10, 35, (6.0, 12.0)),
    'example2': (10, 35, (5.0,)),
    'example3': (5, 35, (3.0, 6.0)),
    'example4': (5, 35, (3.0, 5.0, 9.0)),
    'example5': (5, 35, (3.0,)),
    'example6': (5, 35, (1.0, 2.0, 3.0)),
}


def scenario_of(name):
    return load_scenario(FOLDER / f'{name}.yaml')


def states_of(name, seed=0):
    """Return frame numbers and states (n, 4) of every object by its id."""
    found = {}
    truth = scenario_of(name).truth(1.0, 1.0, np.random.default_rng(seed))
    for frame, objects in enumerate(truth, start=1):
        for item in objects:
            frames, states = found.setdefault(item.id, ([], []))
            frames.append(frame)
            states.append(item.state)
    return {key: (frames, np.array(states)) for key, (frames, states) in found.items()}


def steps(states):
    """Return the distance moved from each frame to the next [cells]."""
    return np.hypot(*np.diff(states[:, POS], axis=0).T)


@pytest.mark.parametrize('name', NAMES)
def test_every_scenario_loads_and_stays_in_the_frame(name):
    scenario = scenario_of(name)
    assert scenario.description
    assert (scenario.frames, scenario.shape) == (40, (20, 20))
    found = states_of(name)
    assert set(found) == {item.id for item in scenario.objects}
    for item in scenario.objects:
        frames, states = found[item.id]
        assert frames == list(range(item.first_frame, item.last_frame + 1))
        # At least half a cell from the border, so that estimates have room on every side.
        assert np.all((states[:, POS] >= 0.0) & (states[:, POS] <= 19.0)) or item.random


@pytest.mark.parametrize('name', PAPER)
def test_example_has_the_frames_and_snrs_of_the_paper(name):
    first, last, snrs_db = PAPER[name]
    scenario = scenario_of(name)
    assert [(item.first_frame, item.last_frame) for item in scenario.objects] == [(first, last)]
    assert scenario.snrs_db == snrs_db
    assert scenario.snr_db in snrs_db
    comment = (FOLDER / f'{name}.yaml').read_text(encoding='utf-8')
    assert 'not available' in ' '.join(comment.replace('#', '').split())


@pytest.mark.parametrize('name', [name for name in NAMES if name != 'example5'])
def test_objects_move_at_most_one_cell_a_frame(name):
    for _, states in states_of(name).values():
        assert steps(states).max() <= 1.0


@pytest.mark.parametrize('name', [name for name in NAMES if name != 'example5'])
def test_objects_move_smoothly(name):
    for _, states in states_of(name).values():
        change = np.hypot(*np.diff(states[:, VEL], axis=0).T)
        assert change.max() < 0.3


def test_example_5_is_fast_then_slow_with_a_sharp_turn_then_fast():
    (frames, states), = states_of('example5').values()
    moved = dict(zip(frames[1:], steps(states)))
    assert all(moved[k] > 1.0 for k in range(6, 17))
    assert all(moved[k] <= 1.0 for k in range(17, 29))
    assert all(moved[k] > 1.0 for k in range(29, 36))
    before, after = states[frames.index(16), VEL], states[frames.index(28), VEL]
    cosine = before @ after / np.hypot(*before) / np.hypot(*after)
    assert np.rad2deg(np.arccos(cosine)) > 120.0


def test_example_5_skips_cells_while_it_is_fast():
    (frames, states), = states_of('example5').values()
    jump = abs(np.diff(np.floor(states[:, POS] + 0.5), axis=0)).max(axis=1)
    skipped = dict(zip(frames[1:], jump > 1))
    assert sum(skipped[k] for k in range(6, 17)) >= 3
    assert not any(skipped[k] for k in range(17, 29))
    assert sum(skipped[k] for k in range(29, 36)) >= 2


@pytest.mark.parametrize(('name', 'count'), [('crossing', 2), ('three_crossing', 3)])
def test_crossing_objects_meet_in_one_cell(name, count):
    found = states_of(name)
    meeting = [np.floor(states[frames.index(20), POS] + 0.5) for frames, states in found.values()]
    assert len(meeting) == count
    assert len(np.unique(meeting, axis=0)) == 1


def test_three_objects_keep_apart():
    found = list(states_of('three_objects').values())
    assert len(found) == 3
    for n, (frames, states) in enumerate(found):
        for other_frames, other in found[n + 1:]:
            for k in set(frames) & set(other_frames):
                gap = states[frames.index(k), POS] - other[other_frames.index(k), POS]
                assert np.hypot(*gap) > 3.0


def test_random_object_differs_by_seed_within_its_speeds():
    for seed in range(5):
        (_, states), = states_of('random', seed).values()
        speed = np.hypot(*states[:, VEL].T)
        assert np.all((speed >= 0.3) & (speed <= 0.9))
    (_, first), = states_of('random', 0).values()
    (_, second), = states_of('random', 1).values()
    assert not np.array_equal(first, second)
