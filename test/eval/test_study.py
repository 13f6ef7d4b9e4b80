# SPDX-License-Identifier: Apache-2.0
"""Studies: their plan, their identity, and their results folder."""

from dataclasses import replace
import functools
import json
from pathlib import Path
import shutil

from lowsnr_detect.parts.registry import DETECTORS
from lowsnr_eval.study.experiment import run_block
from lowsnr_eval.study.study import StudyOptions
from lowsnr_eval.study.study_folder import open_folder
from lowsnr_eval.study.study_folder import OtherStudyError
from lowsnr_eval.study.study_identity import differences
from lowsnr_eval.study.study_identity import identity
from lowsnr_eval.study.study_plan import plan_study
from lowsnr_eval.study.study_results import join_blocks
from lowsnr_eval.study.study_results import merit_rows
from lowsnr_eval.study.study_results import summary
import numpy as np
import pytest

CONFIG = Path(__file__).resolve().parents[2] / 'config'
SMALL = StudyOptions(example=2, runs=3, snrs_db=(9.0,), detectors=('cdt',))
# Readers of summary.json rely on these names.
KEYS = {'detector', 'snr_db', 'operating_point', 'level', 'pfa_per_frame', 'pd', 'pd_interval',
        'rmse_position_m', 'rmse_velocity_mps', 'gospa_m', 'runs', 'seed'}


@functools.cache
def plan(**changes):
    return plan_study(replace(SMALL, **changes), CONFIG)


def thresholds(study):
    return dict.fromkeys(study.calibrations(), 6.0)


@pytest.fixture(scope='module')
def blocks():
    study = plan()
    return study, {name: run_block(block)
                   for name, block in study.blocks(thresholds(study)).items()}


def test_methods_of_the_paper_take_part_in_all_runs_and_others_in_few():
    study = plan(example=4, runs=200, snrs_db=None, detectors=None)
    assert study.snrs_db == (3.0, 5.0, 9.0)
    assert set(DETECTORS) < set(study.labels)
    case = next(case for case in study.cases if case.kind == 'object')
    runs = {method.label: method.runs for method in case.methods}
    assert runs['sdt'] == runs['mmtbd2'] == 200
    assert runs['hmm'] == 10
    settings = {method.label: method.detector for method in case.methods}
    assert settings['sdt'].max_iterations == 3
    assert settings['sdt'].sensor.snr_db == case.snr_db


def test_points_of_the_snr_curve_are_calibrated_with_fewer_runs():
    study = plan(snrs_db=(3.0, 9.0))
    runs = {(detector.sensor.snr_db, runs) for detector, _, _, runs in study.calibrations()}
    assert runs == {(3.0, None), (9.0, None), (1.0, 150), (6.0, 150), (12.0, 150)}


def test_motion_covers_the_speeds_of_the_fast_example():
    case = plan(example=5, detectors=('sdt', 'mmtbd2')).cases[0]
    settings = {method.label: method for method in case.methods}
    assert settings['sdt_r2'].detector.radius == 2
    assert settings['mmtbd2'].detector.motion.max_speed_mps == 1.5
    assert settings['mmtbd2'].tracker.motion.max_speed_mps == 1.5


def test_blocks_cover_every_run_once():
    study = plan(runs=50)
    ranges = [(block.first, block.count)
              for name, block in study.blocks(thresholds(study)).items()
              if name.startswith('object')]
    assert ranges == [(0, 20), (20, 20), (40, 10)]


@pytest.mark.parametrize(('changes', 'culprit'), [
    ({'example': 7}, 'example 7'), ({'runs': 0}, 'runs = 0'),
    ({'detectors': ('sdr',)}, "'sdr'"), ({'snrs_db': (900.0,)}, '900'),
])
def test_impossible_study_is_rejected_by_name(changes, culprit):
    with pytest.raises(ValueError, match=culprit) as error:
        plan(**changes)
    assert '\n' not in str(error.value)


def test_rows_of_the_summary_have_the_stated_keys(blocks):
    study, results = blocks
    joined = join_blocks(study, results.items())
    found = merit_rows(joined)
    assert all(set(row) >= KEYS for row in found)
    assert {(row['operating_point'], row['level']) for row in found} == {
        (point, level) for point in ('nominal', 'matched')
        for level in ('detection', 'tracking')}
    assert {row['runs'] for row in found} == {3}
    json.dumps(summary(joined, {}), allow_nan=False)


def test_saved_block_is_read_back(tmp_path, blocks):
    study, results = blocks
    folder = open_folder(tmp_path / 'example2', study, resume=False)
    name, block = next(iter(results.items()))
    assert folder.load(name) is None
    folder.save(name, block)
    again = join_blocks(study, [(name, folder.load(name))])
    assert merit_rows(again) == merit_rows(join_blocks(study, [(name, block)]))


def other_value(path):
    """Change one value of a block."""
    with np.load(path) as archive:
        arrays = dict(archive)
    key = next(key for key in arrays if key.endswith('declared'))
    np.savez_compressed(path, **{**arrays, key: arrays[key] + 1})


def other_type(path):
    """Put a text in the place of an array."""
    with np.load(path) as archive:
        arrays = dict(archive)
    np.savez_compressed(path, **{**arrays, next(key for key in arrays if '/' in key): 'text'})


def one_array(path):
    """Put an array in the place of the archive."""
    with path.open('wb') as file:
        np.save(file, np.zeros(3))


SPOILT = {
    'cut': lambda path: path.write_bytes(path.read_bytes()[:200]),
    'cut at the end': lambda path: path.write_bytes(path.read_bytes()[:-20]),
    'empty': lambda path: path.write_bytes(b''),
    'one byte': lambda path: path.write_bytes(
        path.read_bytes()[:300] + bytes([path.read_bytes()[300] ^ 255])
        + path.read_bytes()[301:]),
    'array': one_array,
    'archive of others': lambda path: np.savez(path, frames=np.zeros(3)),
    'another value': other_value, 'another type': other_type}


@pytest.mark.parametrize('spoil', SPOILT.values(), ids=SPOILT)
def test_block_that_is_not_as_it_was_written_is_named_and_not_used(tmp_path, blocks, spoil):
    study, results = blocks
    told = []
    folder = open_folder(tmp_path / 'example2', study, False, told.append)
    name, block = next(iter(results.items()))
    folder.save(name, block)
    path = folder.path / 'runs' / f'{name}.npz'
    spoil(path)
    assert folder.load(name) is None
    line, = told
    assert line.startswith(f'{path}: ')
    assert line.isprintable()


def test_block_of_other_runs_is_not_used(tmp_path, blocks):
    study, results = blocks
    told = []
    folder = open_folder(tmp_path / 'example2', study, False, told.append)
    (name, block), (other, _) = list(results.items())[:2]
    folder.save(name, block)
    shutil.copy(folder.path / 'runs' / f'{name}.npz', folder.path / 'runs' / f'{other}.npz')
    assert folder.load(other) is None
    assert len(told) == 1


@pytest.mark.parametrize('text', [
    '', '[]', '{"format": 2}', '{"format": 2, "identity": 3}', '[' * 100_000, '\0', 'null'])
def test_folder_whose_identity_is_damaged_is_left_alone(tmp_path, text):
    open_folder(tmp_path / 'example2', plan(), resume=False)
    (tmp_path / 'example2' / 'study.json').write_text(text)
    for resume in (True, False):
        with pytest.raises(ValueError, match=f'^{tmp_path}'):
            open_folder(tmp_path / 'example2', plan(), resume)


def test_new_study_leaves_the_results_of_another_alone(tmp_path):
    first = open_folder(tmp_path / 'example2', plan(), resume=False)
    second = open_folder(tmp_path / 'example2', plan(runs=5), resume=False)
    assert second.path == tmp_path / 'example2-2'
    kept = json.loads((first.path / 'study.json').read_text())['identity']
    assert differences(kept, identity(plan())) == {}
    assert differences(kept, identity(plan(runs=5)))['study.options.runs'] == (3, 5)


def with_change(name):
    """Return the small study, and one that differs in its gate, scenario or sensor."""
    case = plan().cases[0]
    if name == 'gate':
        changed = replace(case, evaluation=replace(case.evaluation, gate_cells=4.0))
    elif name == 'scenario':
        moved = replace(case.scenario.objects[0], snr_offset_db=1.5)
        changed = replace(case, scenario=replace(case.scenario, objects=(moved,)))
    else:
        changed = replace(case, sensor=replace(case.sensor, blur_m=0.7))
    return replace(plan(), cases=(changed, *plan().cases[1:]))


def test_resume_continues_in_the_folder_of_the_same_study(tmp_path):
    fresh = open_folder(tmp_path / 'example2', plan(), resume=True)
    again = plan_study(SMALL, CONFIG)
    assert open_folder(tmp_path / 'example2', again, resume=True).path == fresh.path


@pytest.mark.parametrize(('name', 'path', 'old', 'new'), [
    ('gate', 'evaluation.gate_cells', '1.5', '4.0'),
    ('scenario', 'scenario.objects[0].snr_offset_db', '0.0', '1.5'),
    ('sensor', 'sensor.blur_m', '0.0', '0.7'),
])
def test_resume_in_the_folder_of_another_study_is_rejected_by_name(
        tmp_path, name, path, old, new):
    open_folder(tmp_path / 'example2', plan(), resume=False)
    with pytest.raises(OtherStudyError) as error:
        open_folder(tmp_path / 'example2', with_change(name), resume=True)
    assert error.value.changed == {f'study.cases[0].{path}': (old, new)}
    text = str(error.value)
    assert '\n' not in text
    assert all(part in text for part in (path, old, new, str(tmp_path)))


@pytest.mark.parametrize('resume', [True, False])
@pytest.mark.parametrize('content', ['{"format": 0}', '{"format": 2}', '[]', 'not JSON', None])
def test_folder_with_other_files_is_rejected_and_left_alone(tmp_path, resume, content):
    folder = tmp_path / 'example2'
    folder.mkdir()
    name = 'study.json' if content else 'notes.txt'
    (folder / name).write_text(content or 'mine')
    with pytest.raises(ValueError, match='example2') as error:
        open_folder(folder, plan(), resume)
    assert not isinstance(error.value, OtherStudyError)
    assert (folder / name).read_text() == (content or 'mine')
    assert len(list(folder.iterdir())) == 1
