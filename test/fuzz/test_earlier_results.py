# SPDX-License-Identifier: Apache-2.0
"""Results of an earlier run or study are continued, made again, or rejected by their name."""

import json

from fuzz.counting import fuzz
from fuzz.counting import tried
from fuzz.strategies import damaged
from fuzz.strategies import names
from fuzz.strategies import numbers
from fuzz.strategies import whole
from fuzz.test_files import write_results
from hypothesis import strategies as st
from lowsnr_common.settings.flat_values import flat_values
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.scene.scene_writer import SceneWriter
from lowsnr_eval.scoring.entry_tables import EntryTables
from lowsnr_eval.scoring.final_summary import summarize_folder
from lowsnr_eval.scoring.score_tables import ScoreTables
import pytest
import yaml

RESTARTS = 'time_s,node,frame\n1.5,sdt_detector,7\n2.5,tracker,9\n'
values = st.none() | whole | numbers | names | st.lists(whole, max_size=2)
summaries = st.builds(lambda frames: json.dumps({'frames': frames}), values | st.dictionaries(
    st.sampled_from(['published', 'scored', 'unseen', 'lost']), values, max_size=4))
parameters = st.builds(
    lambda name, value: yaml.safe_dump({'/evaluator': {'ros__parameters': {
        'detectors': ['sdt'], name: value}}}),
    st.sampled_from(['seed', 'detectors', 'gate_cells', 'scenario', 'truth', 'rows']),
    st.none() | numbers | st.booleans() | st.lists(st.integers(-5, 5), max_size=2)
) | st.sampled_from(['', '[]', '/evaluator: 3', '/evaluator: {ros__parameters: [abc]}', '{'])


@pytest.fixture(scope='module')
def results(tmp_path_factory):
    """Return the files of a results folder by name."""
    folder = tmp_path_factory.mktemp('results')
    write_results(folder)
    run = flat_values(RunSettings(detectors=('sdt',))) | flat_values(Evaluation())
    (folder / 'parameters.yaml').write_text(yaml.safe_dump(
        {'/evaluator': {'ros__parameters': {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in run.items()}}}))
    (folder / 'restarts.csv').write_text(RESTARTS)
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def restored(place, results, name, content):
    """Write all results, one of them with other content."""
    for other, whole_file in results.items():
        (place / other).write_bytes(whole_file)
    (place / name).write_bytes(content if isinstance(content, bytes) else content.encode())


def test_sound_results_are_summed_up(place, results):
    restored(place, results, 'summary.json', json.dumps({'frames': {
        'published': 9, 'scored': 4, 'unanswered': 0, 'unseen': 3, 'lost': 2}}))
    summarize_folder(place)
    found = json.loads((place / 'summary.json').read_text())
    assert found['frames'] == {
        'expected': None, 'published': 9, 'scored': 4, 'unanswered': 0, 'unseen': 3, 'lost': 2}
    assert found['restarts'] == {'sdt_detector': 1, 'tracker': 1}


@fuzz('earlier results', 400, name=st.sampled_from(
    ['summary.json', 'parameters.yaml', 'restarts.csv', 'frames.csv', 'latency.csv',
     'tracks.csv', 'truth.csv']),
    data=st.data())
def test_earlier_results_are_summed_up_or_rejected_by_name(place, results, name, data):
    kinds = damaged(results[name])
    if name == 'summary.json':
        kinds |= summaries
    elif name == 'parameters.yaml':
        kinds |= parameters
    restored(place, results, name, data.draw(kinds))
    tried(place, summarize_folder, place)
    if (place / 'summary.json').stat().st_size and name != 'summary.json':
        assert json.loads((place / 'summary.json').read_text())['frames']['published'] < 2**53


def resumed(place):
    """Continue the files of a run as a restarted evaluator does."""
    ScoreTables(place, ['sdt'], resumed=True).close()
    EntryTables(place, 1.0, after=2).close()
    SceneWriter(place, 1.0, resumed=True).close()


@fuzz('continued results', 300, name=st.sampled_from(
    ['frames.csv', 'latency.csv', 'tracks.csv', 'truth.csv', 'scene.jsonl', 'frames.f32']),
    data=st.data())
def test_damaged_results_are_continued_or_rejected_by_name(place, results, name, data):
    restored(place, results, name, data.draw(damaged(results[name])))
    tried(place, resumed, place)


@pytest.mark.parametrize('name', ['parameters.yaml', 'restarts.csv', 'frames.csv'])
@pytest.mark.parametrize('fault', ['folder', 'dangling link', 'loop'])
def test_what_is_no_file_is_named(place, results, name, fault):
    restored(place, results, name, b'')
    (place / name).unlink()
    if fault == 'folder':
        (place / name).mkdir()
    else:
        (place / name).symlink_to(name if fault == 'loop' else 'nowhere')
    tried(place, summarize_folder, place)


@pytest.mark.parametrize('value', ['inf', 'nan', '-inf', '1e308', '9' * 400, '9' * 5000])
@pytest.mark.parametrize('column', [0, 1, 5, 7, 8, 9, 10, 11])  # the others hold texts or ids
def test_number_that_no_run_has_is_rejected_by_the_name_of_its_file(
        place, results, column, value):
    header, *lines = results['frames.csv'].decode().splitlines()
    rows = [line.split(',') for line in lines]
    for row in rows:
        row[column] = value
    restored(place, results, 'frames.csv', '\n'.join([header, *map(','.join, rows), '']))
    for call in (summarize_folder, resumed):
        with pytest.raises(ValueError, match=f'^{place}/frames.csv: '):
            call(place)
