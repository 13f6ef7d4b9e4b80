# SPDX-License-Identifier: Apache-2.0
"""The results folder: what is in its files, that nothing is lost, and nothing overwritten."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
import errno
import json
from threading import Barrier

from disk import fill
from lowsnr_bringup.run.frame_ledger import FrameLedger
from lowsnr_bringup.run.results_folder import Account
from lowsnr_bringup.run.results_folder import fresh_folder
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Truth
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.report.table import format_table
from lowsnr_eval.scoring.final_summary import reserve_summary
from lowsnr_eval.scoring.final_summary import summarize
from lowsnr_eval.scoring.final_summary import write_summary
from lowsnr_eval.scoring.frame_scoring import Answer
from lowsnr_eval.scoring.frame_scoring import score_frame
from lowsnr_eval.scoring.score_tables import read_frames
from lowsnr_eval.scoring.score_tables import ScoreTables
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
LATENCY_CSV = 'frame,detector,latency_ms,detection_ms\n2,sdt,2.346,1.000\n'


def score_two_frames(tables):
    """Write two frames of one chain; it does not answer the first with tracks."""
    for frame, stamp_s, truth, answer in (
            (1, 1.0, [], Answer([], None)),
            (2, 1700000000.123457, [OBJECT], Answer([DETECTION], [TRACK], 2.34567, 1.0))):
        answers = {'sdt': answer}
        tables.add(score_frame(frame, stamp_s, truth, answers, Evaluation()), answers)


def summary_of(folder, scenario='example3', ledger=None):
    """Return the summary of a run whose tables lie in a folder."""
    return summarize(folder, RunSettings(scenario=scenario), Evaluation(), 7, Account(ledger))


@pytest.fixture
def results(tmp_path):
    """Return a folder with the tables of two frames."""
    with closing(ScoreTables(tmp_path, ['sdt'])) as tables:
        score_two_frames(tables)
    return tmp_path


@pytest.fixture
def no_results(tmp_path):
    """Return a folder with tables that hold no frame."""
    ScoreTables(tmp_path, ['sdt']).close()
    return tmp_path


def test_files_hold_the_scores_at_once(tmp_path):
    with closing(ScoreTables(tmp_path, ['sdt'])) as tables:
        score_two_frames(tables)
        assert (tmp_path / 'frames.csv').read_text() == FRAMES_CSV
        assert (tmp_path / 'latency.csv').read_text() == LATENCY_CSV


def test_scores_are_read_back_as_they_were(results):
    first, second = read_frames(results / 'frames.csv', ['sdt'])
    assert first == score_frame(1, 1.0, [], {'sdt': Answer([], None)}, Evaluation())
    assert second == score_frame(
        2, 1700000000.123457, [OBJECT], {'sdt': Answer([DETECTION], [TRACK])}, Evaluation())


@pytest.mark.parametrize('ids', [(), ('',), ('', ''), ('a b', 'c,d'), ('%', '%25', '\n', '物体')])
def test_any_ids_are_read_back_as_they_were(tmp_path, ids):
    truth = [Truth(name, np.array([9.0 * k, 0.0, 0.0, 0.0])) for k, name in enumerate(ids)]
    found = [Estimate(item.state, np.eye(4), 0.9, '') for item in truth]
    answers = {'sdt': Answer(found, found)}
    scores = score_frame(1, 1.0, truth, answers, Evaluation())
    with closing(ScoreTables(tmp_path, ['sdt'])) as tables:
        tables.add(scores, answers)
    assert list(read_frames(tmp_path / 'frames.csv', ['sdt'])) == [scores]
    assert scores[0].comparison.hit_ids == scores[0].object_ids == ids


def test_summary_has_the_stable_keys(results):
    ledger = FrameLedger(number=2)
    ledger.publish(3)
    write_summary(results, summary_of(results, ledger=ledger))
    summary = json.loads((results / 'summary.json').read_text())
    assert list(summary) == [
        'schema', 'scenario', 'seed', 'frames', 'restarts', 'evaluation', 'detectors']
    assert (summary['schema'], summary['scenario'], summary['seed']) == (1, 'example3', 7)
    assert summary['frames'] == {
        'expected': None, 'published': 3, 'scored': 1, 'unanswered': 1, 'unseen': 1, 'lost': 0}
    assert summary['restarts'] == {}
    assert summary['evaluation']['gate_cells'] == 1.5
    chain = summary['detectors']['sdt']
    assert chain['operating_point'] == 'matched'
    assert chain['detection']['pd'] == 1.0
    assert chain['detection']['rmse_velocity_mps'] is None
    assert chain['tracking']['pfa_per_frame'] is None
    assert chain['tracking']['gospa_m'] == 0.5
    assert chain['latency_ms'] == {'median': 2.346, 'p99': 2.346}
    assert chain['detection_latency_ms'] == {'median': 1.0, 'p99': 1.0}
    assert {'pd', 'pfa_per_frame', 'first_detection_latency_frames', 'rmse_position_m',
            'rmse_velocity_mps'} <= set(chain['detection'])


def test_summary_of_no_frames_has_no_figures(no_results):
    summary = summary_of(no_results)
    assert summary['frames'] == {
        'expected': None, 'published': 0, 'scored': 0, 'unanswered': 0, 'unseen': 0, 'lost': 0}
    assert summary['detectors']['sdt']['detection']['pd'] is None


def test_summary_that_cannot_be_written_leaves_the_old_one(tmp_path):
    write_summary(tmp_path, {'pd': 0.5})
    with pytest.raises(ValueError):
        write_summary(tmp_path, {'pd': float('nan')})
    with pytest.raises(ValueError) as caught:
        write_summary(tmp_path / 'none', {'pd': 0.5})
    assert str(tmp_path / 'none') in str(caught.value)
    assert json.loads((tmp_path / 'summary.json').read_text()) == {'pd': 0.5}
    assert [path.name for path in tmp_path.iterdir()] == ['summary.json']


def test_earlier_results_are_never_overwritten(results):
    with pytest.raises(ValueError) as caught:
        ScoreTables(results, ['sdt'])
    assert str(results) in str(caught.value)
    assert (results / 'frames.csv').read_text() == FRAMES_CSV


def test_fresh_folder_is_the_one_asked_for_or_the_next_number(tmp_path):
    wanted = tmp_path / 'results' / 'example1'
    found = [fresh_folder(wanted) for _ in range(3)]
    assert found == [wanted, wanted.with_name('example1-2'), wanted.with_name('example1-3')]
    for folder in found:
        ScoreTables(folder, ['sdt']).close()


def test_fresh_folder_takes_an_empty_one_and_leaves_a_full_one(tmp_path):
    empty, full = tmp_path / 'empty', tmp_path / 'full.d'
    empty.mkdir()
    full.mkdir()
    (full / 'notes.txt').write_text('mine')
    assert fresh_folder(empty) == empty
    assert fresh_folder(full) == tmp_path / 'full.d-2'
    assert [path.name for path in full.iterdir()] == ['notes.txt']


@pytest.mark.parametrize('below', ['', 'deeper', 'deeper/still'])
def test_folder_that_cannot_be_made_is_named_with_the_option(below, tmp_path):
    file = tmp_path / 'file'
    file.write_text('mine')
    with pytest.raises(ValueError) as caught:
        fresh_folder(file / below)
    message = str(caught.value)
    assert str(file / below) in message
    assert '--results' in message
    assert '\n' not in message
    assert file.read_text() == 'mine'


def test_writer_names_the_folder_that_is_missing(tmp_path):
    with pytest.raises(ValueError) as caught:
        ScoreTables(tmp_path / 'none', ['sdt'])
    assert str(tmp_path / 'none') in str(caught.value)


def test_table_shows_figures_intervals_and_what_they_rest_on(results):
    text = format_table(summary_of(results))
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


def test_table_of_real_frames_states_pixels(results):
    summary = summary_of(results)
    summary['evaluation'] |= {'pixels': True, 'sensor.cell_size_m': 0.5}
    lines = format_table(summary).splitlines()
    assert lines[3].split()[-3:] == ['[px]', '[px/s]', '[px]']
    row = next(line.split() for line in lines if line.split()[:2] == ['sdt', 'tracking'])
    assert row[-3:] == ['1.00', '0.50', '1.00']  # twice the metres


def test_table_of_no_frames_has_dashes_only(no_results):
    text = format_table(summary_of(no_results))
    row = next(line for line in text.splitlines() if line.startswith('sdt '))
    assert row.split() == ['sdt', 'detection'] + 7 * ['-']


def test_table_columns_end_together(no_results):
    lines = format_table(summary_of(no_results)).splitlines()
    assert lines[3].startswith('detector  level')
    dashes = [[n for n, char in enumerate(line) if char == '-'] for line in lines[4:6]]
    assert dashes[0] == dashes[1]
    assert len(lines[3]) == len(lines[4]) == len(lines[5])


def test_runs_that_start_at_once_have_a_folder_each(tmp_path):
    runs = 16
    start = Barrier(runs)

    def begin(_):
        start.wait()
        return fresh_folder(tmp_path / 'run')

    with ThreadPoolExecutor(runs) as pool:
        found = set(pool.map(begin, range(runs)))
    assert len(found) == runs


def test_summary_has_room_on_a_full_disk(results, small_disk):
    reserve_summary(small_disk, 1)
    fill(small_disk / 'ballast')
    write_summary(small_disk, summary_of(results))
    assert json.loads((small_disk / 'summary.json').read_text())['frames']['scored'] == 1
    with pytest.raises(OSError) as caught:
        reserve_summary(small_disk, 100)
    assert caught.value.errno == errno.ENOSPC
