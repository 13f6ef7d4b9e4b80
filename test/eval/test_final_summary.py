# SPDX-License-Identifier: Apache-2.0
"""The summary of a run has all that was scored, however the run ended."""

from contextlib import closing
import json
import subprocess
import sys

from lowsnr_bringup.plan.config_files import to_yaml
from lowsnr_bringup.run.earlier_run import earlier_alarm_rates
from lowsnr_bringup.run.frame_ledger import FrameLedger
from lowsnr_bringup.run.results_folder import Account
from lowsnr_common.core.records import AlarmRate
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.report.table import format_table
from lowsnr_eval.scoring.final_summary import summarize_folder
from lowsnr_eval.scoring.final_summary import summarize_run
from lowsnr_eval.scoring.final_summary import write_summary
from lowsnr_eval.scoring.run_scoring import RunScorer
from lowsnr_eval.scoring.run_scoring import TRUTH
import pytest

SECOND = 1_000_000_000
EVALUATOR = {'scenario': 's', 'seed': 4, 'detectors': ['sdt'], 'operating_points': ['matched']}


def score_frames(folder, frames):
    """Score empty frames."""
    with closing(RunScorer(
            RunSettings(results=str(folder), scenario='s'), Evaluation(), print)) as scorer:
        for k in range(1, frames + 1):
            for topic in (TRUTH, 'detections', 'tracks'):
                scorer.add_array(topic, k * SECOND, [], float(k))
            scorer.score()


def ledger_of(published, scored):
    """Return the ledger of a run of which the first frames were announced as scored."""
    ledger = FrameLedger()
    for k in range(1, published + 1):
        ledger.publish(k * SECOND)
    for k in range(1, scored + 1):
        ledger.score(k * SECOND, k)
    return ledger


def summary_in(folder):
    return json.loads((folder / 'summary.json').read_text())


def test_summary_has_the_scores_and_the_account_of_the_starter(tmp_path):
    score_frames(tmp_path, 5)
    summary = summarize_run(tmp_path, EVALUATOR, Account(ledger_of(8, 5), {'evaluator': 1}))
    assert summary['frames'] == {
        'expected': None, 'published': 8, 'scored': 5, 'unanswered': 0, 'unseen': 3, 'lost': 0}
    assert (summary['scenario'], summary['seed']) == ('s', 4)
    assert summary['restarts'] == {'evaluator': 1}
    assert summary['detectors']['sdt']['operating_point'] == 'matched'


@pytest.mark.parametrize('content', [None, b''], ids=['no table', 'an empty table'])
def test_run_that_scored_nothing_leaves_no_summary(tmp_path, content):
    if content is not None:
        (tmp_path / 'frames.csv').write_bytes(content)
    assert summarize_run(tmp_path, EVALUATOR, Account()) is None


def test_summary_and_table_have_the_false_alarm_rate_asked_and_measured(tmp_path):
    score_frames(tmp_path, 5)
    for rate, shown in (
            (AlarmRate(0.01, 0.0125), 'asked 0.01, scored 0.000 [0.000, 0.434], measured by the '
             'detector 0.0125'),
            (AlarmRate(1e-5), 'asked 1e-05, scored 0.000 [0.000, 0.434], measured by the '
             'detector -')):
        summary = summarize_run(
            tmp_path, EVALUATOR, Account(ledger_of(5, 5), {}, {'sdt_detector': rate}))
        chain = summary['detectors']['sdt']
        assert AlarmRate(chain['pfa_asked'], chain['pfa_measured']) == rate
        assert f'sdt: P_FA {shown}' in format_table(summary).splitlines()


@pytest.mark.parametrize('share', ['0.5', 1, -0.1, 1.5, [], float('inf')])
def test_false_alarm_rate_of_an_earlier_summary_is_used_if_it_is_sound(tmp_path, share):
    for found, sound in ((share, False), (0.25, True), (None, True)):
        (tmp_path / 'summary.json').write_text(json.dumps(
            {'detectors': {'sdt': {'pfa_asked': 0.01, 'pfa_measured': found}}}))
        assert earlier_alarm_rates(tmp_path) == (
            {'sdt_detector': AlarmRate(0.01, found)} if sound else {})


def test_frame_that_was_half_written_is_left_out(tmp_path):
    score_frames(tmp_path, 5)
    table = tmp_path / 'frames.csv'
    table.write_bytes(table.read_bytes()[:-10])
    summary = summarize_run(tmp_path, EVALUATOR, Account(ledger_of(5, 5)))
    assert summary['frames'] == {
        'expected': None, 'published': 5, 'scored': 4, 'unanswered': 0, 'unseen': 0, 'lost': 1}


@pytest.mark.parametrize(('name', 'old', 'new'), [
    ('frames.csv', b'3,3.0,sdt,tracking', b'3,3.0,sdt,detection'),
    ('frames.csv', b'3,3.0,sdt,tracking', b'3,3.0,cdt,tracking'),
    ('frames.csv', b'3,3.0,sdt,tracking', b'4,3.0,sdt,tracking'),
    ('frames.csv', b'3,3.0,sdt,tracking', b'x,3.0,sdt,tracking'),
    ('frames.csv', b'3,3.0,sdt,tracking', b'\xff'), ('frames.csv', b'frame,', b''),
    ('latency.csv', b'3,sdt,', b'3,cdt,'), ('latency.csv', b'3,sdt,', b'3,sdt,x')])
def test_table_that_no_evaluator_wrote_is_named(tmp_path, name, old, new):
    score_frames(tmp_path, 5)
    data = (tmp_path / name).read_bytes()
    assert old in data
    (tmp_path / name).write_bytes(data.replace(old, new, 1))
    with pytest.raises(ValueError) as caught:
        summarize_run(tmp_path, EVALUATOR, Account(ledger_of(5, 5)))
    assert str(caught.value).startswith(f'{tmp_path / name}: ')
    assert str(caught.value).isprintable()


def test_summary_of_a_killed_run_is_made_from_its_folder(tmp_path):
    score_frames(tmp_path, 5)
    (tmp_path / 'parameters.yaml').write_text(to_yaml({'/evaluator': EVALUATOR}))
    (tmp_path / 'restarts.csv').write_text(
        'frame,node,death,down_s\n2,cdt.tracker,was killed,1.000\n4,cdt.tracker,was killed,1.0\n')
    summarize_folder(tmp_path)
    first = summary_in(tmp_path)
    assert first['frames'] == {
        'expected': None, 'published': 5, 'scored': 5, 'unanswered': 0, 'unseen': 0, 'lost': 0}
    assert first['restarts'] == {'cdt.tracker': 2}
    # Where bring-up ended well, what it knows of frames that nobody scored is kept.
    whole = summarize_run(tmp_path, EVALUATOR, Account(
        ledger_of(9, 6), {'cdt.tracker': 2}, {'sdt_detector': AlarmRate(0.01, 0.0125)}))
    write_summary(tmp_path, whole)
    first = summary_in(tmp_path)
    summarize_folder(tmp_path)
    assert summary_in(tmp_path) == first
    assert (whole['frames']['unseen'], whole['frames']['lost']) == (3, 1)


@pytest.mark.parametrize('text', [None, '', '[]', '/evaluator: {}', '/sensor: {}', '{'])
def test_folder_without_the_parameters_of_a_run_is_named(tmp_path, text):
    score_frames(tmp_path, 1)
    if text is not None:
        (tmp_path / 'parameters.yaml').write_text(text)
    with pytest.raises(ValueError) as caught:
        summarize_folder(tmp_path)
    assert str(caught.value).startswith(str(tmp_path / 'parameters.yaml'))


MEASURE = """
from pathlib import Path
import resource
import sys
from lowsnr_bringup.run.frame_ledger import FrameLedger
from lowsnr_bringup.run.results_folder import Account
from lowsnr_common.settings.node_settings import Evaluation, RunSettings
from lowsnr_eval.scoring.final_summary import summarize
summary = summarize(Path(sys.argv[1]), RunSettings(), Evaluation(), 0, Account())
print(summary['frames']['scored'], resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def test_memory_of_a_summary_does_not_grow_with_the_run(tmp_path):
    used = {}
    for frames in (1000, 100_000):
        folder = tmp_path / str(frames)
        folder.mkdir()
        score_frames(folder, 1)
        for name, lines in (
                ('frames.csv', '{k},{k}.0,sdt,detection,0,0,0,0,,,0,0,,\n'
                               '{k},{k}.0,sdt,tracking,0,0,0,0,,,0,0,,\n'),
                ('latency.csv', '{k},sdt,{k}.125,0.250\n')):
            with (folder / name).open('a') as file:
                file.writelines(lines.format(k=k) for k in range(2, frames + 1))
        out = subprocess.run(
            [sys.executable, '-c', MEASURE, str(folder)], check=True, capture_output=True,
            text=True, env={'PYTHONPATH': ':'.join(sys.path)}).stdout
        scored, used[frames] = map(int, out.split())
        assert scored == frames
    assert used[100_000] < used[1000] + 4096  # KiB
