"""The results folder: what is in the files, that nothing is lost, and nothing overwritten."""

import json

from lowsnr_bringup.run.results_folder import fresh_folder
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Truth
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_eval.report.table import format_table
from lowsnr_eval.scoring.frame_scoring import Answer
from lowsnr_eval.scoring.results import ResultsWriter
from lowsnr_eval.scoring.results import summarize
from lowsnr_eval.scoring.tallies import Scoreboard
import numpy as np
import pytest

OBJECT = Truth('a', np.array([3.0, 1.0, 5.0, 0.0]))
TRACK = Estimate(np.array([3.5, 1.0, 5.0, 0.25]), np.eye(4), 0.9, '1')
DETECTION = Estimate(np.array([3.0, np.nan, 6.0, np.nan]), np.eye(4), 0.9)
FRAMES_CSV = """\
frame,stamp_s,detector,level,objects,declared,hits,false_alarms,rmse_position_m,\
rmse_velocity_mps,gospa_m,velocities,object_ids,hit_ids
1,1.0,sdt,detection,0,0,0,0,,,0,0,,
1,1.0,sdt,tracking,0,,,,,,,,,
2,1700000000.123457,sdt,detection,1,1,1,0,1,,1,0,a,a
2,1700000000.123457,sdt,tracking,1,1,1,0,0.5,0.25,0.5,1,a,a
"""


@pytest.fixture
def board():
    return Scoreboard(Evaluation(), ['sdt'])


def score_two_frames(board, writer):
    writer.add_scores(board.score_frame(1, 1.0, [], {'sdt': Answer([], None)}))
    answer = Answer([DETECTION], [TRACK], 2.34567, 1.0)
    writer.add_scores(board.score_frame(2, 1700000000.123457, [OBJECT], {'sdt': answer}))
    writer.add_latency(2, 'sdt', answer)


def test_files_hold_the_scores(board, tmp_path):
    with ResultsWriter(tmp_path) as writer:
        score_two_frames(board, writer)
    assert (tmp_path / 'frames.csv').read_text() == FRAMES_CSV
    assert (tmp_path / 'latency.csv').read_text() == (
        'frame,detector,latency_ms,detection_ms\n2,sdt,2.346,1.000\n')


def test_every_line_is_on_disk_at_once(board, tmp_path):
    with ResultsWriter(tmp_path) as writer:
        score_two_frames(board, writer)
        assert (tmp_path / 'frames.csv').read_text() == FRAMES_CSV
        assert (tmp_path / 'latency.csv').read_text().endswith('2,sdt,2.346,1.000\n')


def test_summary_has_the_stable_keys(board, tmp_path):
    with ResultsWriter(tmp_path) as writer:
        score_two_frames(board, writer)
        writer.write_summary(summarize(board, scenario='example3', seed=7, published=3))
    summary = json.loads((tmp_path / 'summary.json').read_text())
    assert summary['schema'] == 1
    assert (summary['scenario'], summary['seed']) == ('example3', 7)
    assert summary['frames'] == {
        'published': 3, 'scored': 1, 'unanswered': 2, 'unseen': 0}
    assert summary['evaluation']['gate_cells'] == 1.5
    chain = summary['detectors']['sdt']
    assert chain['detection']['pd'] == 1.0
    assert chain['detection']['rmse_velocity_mps'] is None
    assert chain['tracking']['pfa_per_frame'] is None
    assert chain['tracking']['gospa_m'] == 0.5
    assert chain['latency_ms'] == pytest.approx({'median': 2.34567, 'p99': 2.34567})
    assert {'pd', 'pfa_per_frame', 'first_detection_latency_frames', 'rmse_position_m',
            'rmse_velocity_mps'} <= set(chain['detection'])


def test_summary_can_be_written_before_the_first_frame_and_again(board, tmp_path):
    with ResultsWriter(tmp_path) as writer:
        writer.write_summary(summarize(board, scenario='s', seed=0, published=0))
        first = json.loads((tmp_path / 'summary.json').read_text())
        score_two_frames(board, writer)
        writer.write_summary(summarize(board, scenario='s', seed=0, published=2))
    assert first['frames'] == {
        'published': 0, 'scored': 0, 'unanswered': 0, 'unseen': 0}
    assert first['detectors']['sdt']['detection']['pd'] is None
    assert json.loads((tmp_path / 'summary.json').read_text())['frames']['scored'] == 1
    assert {path.name for path in tmp_path.iterdir()} == {
        'frames.csv', 'latency.csv', 'summary.json'}


def test_summary_that_cannot_be_written_leaves_the_old_one(tmp_path):
    with ResultsWriter(tmp_path) as writer:
        writer.write_summary({'pd': 0.5})
        with pytest.raises(ValueError, match='not JSON compliant'):
            writer.write_summary({'pd': float('nan')})
    assert json.loads((tmp_path / 'summary.json').read_text()) == {'pd': 0.5}


def test_earlier_results_are_never_overwritten(board, tmp_path):
    with ResultsWriter(tmp_path) as writer:
        score_two_frames(board, writer)
    with pytest.raises(ValueError, match=r'frames\.csv holds earlier results'):
        ResultsWriter(tmp_path)
    assert (tmp_path / 'frames.csv').read_text() == FRAMES_CSV


def test_fresh_folder_is_the_one_asked_for_or_the_next_number(tmp_path):
    wanted = tmp_path / 'results' / 'example1'
    found = [fresh_folder(wanted) for _ in range(3)]
    assert found == [wanted, wanted.with_name('example1-2'), wanted.with_name('example1-3')]
    for folder in found:
        ResultsWriter(folder).close()


def test_fresh_folder_takes_an_empty_one_and_leaves_a_full_one(tmp_path):
    empty, full = tmp_path / 'empty', tmp_path / 'full.d'
    empty.mkdir()
    full.mkdir()
    (full / 'notes.txt').write_text('mine')
    assert fresh_folder(empty) == empty
    assert fresh_folder(full) == tmp_path / 'full.d-2'
    assert [path.name for path in full.iterdir()] == ['notes.txt']


@pytest.mark.parametrize('below', ['', 'deeper', 'deeper/still'])
def test_folder_that_cannot_be_is_refused_in_one_line(below, tmp_path):
    file = tmp_path / 'file'
    file.write_text('mine')
    with pytest.raises(ValueError) as caught:
        fresh_folder(file / below)
    message = str(caught.value)
    assert message.startswith(f'{file / below}: results cannot be written there: ')
    assert message.endswith('; choose another folder with --results')
    assert '\n' not in message
    assert file.read_text() == 'mine'


def test_writer_names_the_folder_that_is_not_there(tmp_path):
    with pytest.raises(ValueError, match=r'none: results cannot be written there: No such file'):
        ResultsWriter(tmp_path / 'none')


def test_table_shows_figures_intervals_and_what_they_rest_on(board, tmp_path):
    with ResultsWriter(tmp_path) as writer:
        score_two_frames(board, writer)
        writer.write_summary(summarize(board, scenario='example3', seed=7, published=2))
    text = format_table(json.loads((tmp_path / 'summary.json').read_text()))
    lines = text.splitlines()
    assert lines[0] == 'example3, seed 7: 2 frames published, 1 scored, 1 unanswered'
    rows = {tuple(line.split()[:2]): line.split() for line in lines if line.startswith('sdt ')}
    assert rows['sdt', 'detection'][2:] == [
        '1.00', '[0.21,', '1.00]', '0.000', '[0.000,', '0.793]', '0', '0.0', '1.00', '-', '0.71']
    assert rows['sdt', 'tracking'][2:] == [
        '1.00', '[0.21,', '1.00]', '-', '0', '0.0', '0.50', '0.25', '0.50']
    assert 'frames without object' in text
    assert 'sdt: 1 frames with object, 0 frames without object' in text
    assert '2.3 ms (median)' in text
    assert max(map(len, lines)) <= 99


def test_table_of_no_frames_has_dashes_only(board):
    text = format_table(summarize(board, scenario='empty', seed=0, published=0))
    row = next(line for line in text.splitlines() if line.startswith('sdt '))
    assert row.split() == ['sdt', 'detection'] + 7 * ['-']


def test_table_columns_end_together(board):
    lines = format_table(summarize(board, scenario='empty', seed=0, published=0)).splitlines()
    assert lines[3].startswith('detector  level')
    dashes = [[n for n, char in enumerate(line) if char == '-'] for line in lines[4:6]]
    assert dashes[0] == dashes[1]
    assert len(lines[3]) == len(lines[4]) == len(lines[5])
