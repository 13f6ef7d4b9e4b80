"""Scoring from messages: with truth, without, and what is written of it."""

import json

from lowsnr_common.core.records import Estimate
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.report.table import format_table
from lowsnr_eval.scoring.run_scoring import Judge
from lowsnr_eval.scoring.run_scoring import TRUTH
import numpy as np
import pytest

SECOND = 1_000_000_000
STATE = np.array([3.0, 0.0, 2.0, 0.0])


def entry(shift=0.0, name=''):
    return Estimate(STATE + shift, np.zeros((4, 4)), 1.0, name)


@pytest.fixture
def judge(tmp_path):
    """Return a function that makes a judge; what it refuses is in ``judge.refused``."""
    made = []

    def make(folder='run', resumed=False, **settings):
        refused = []
        made.append(Judge(
            RunSettings(results=str(tmp_path / folder), scenario='s', **settings), Evaluation(), 4,
            refused.append, resumed))
        made[-1].refused = refused
        return made[-1]

    yield make
    for item in made:
        item.__exit__(None, None, None)


def answer(one, k, shift):
    """Let an object and an answer near it be in frame k."""
    one.add_state(TRUTH, k * SECOND, entry(name='an object'))
    one.add_array(TRUTH, k * SECOND, [entry(name='an object')], float(k))
    one.add_array('detections', k * SECOND, [entry(shift), entry(9.0)], k + 0.1)
    one.add_state('tracks', k * SECOND, entry(shift, '1'))
    one.add_array('tracks', k * SECOND, [entry(shift, '1')], k + 0.2)


def rows(folder):
    return [line.split(',') for line in (folder / 'frames.csv').read_text().splitlines()[1:]]


def test_frame_is_scored_when_all_have_answered(judge, tmp_path):
    one = judge()
    assert one.topics == [TRUTH, 'detections', 'tracks']
    one.add_state(TRUTH, SECOND, entry(name='a'))
    one.add_array(TRUTH, SECOND, [entry(name='a')], 10.0)
    one.add_array('detections', SECOND, [entry(0.1), entry(9.0)], 10.1)
    assert one.score() == []
    one.add_array('tracks', SECOND, [], 10.25)
    (judged,) = one.score()
    assert (judged.stamp, judged.number) == (SECOND, 1)
    assert judged.answers['sdt'].latency_ms == pytest.approx(250.0)
    assert judged.answers['sdt'].detection_ms == pytest.approx(100.0)
    assert [row[4:8] for row in rows(tmp_path / 'run')] == [
        ['1', '2', '1', '1'], ['1', '0', '0', '0']]
    assert not one.add_array('tracks', SECOND, [], 11.0)


def test_without_truth_declarations_are_counted_and_nothing_else(judge, tmp_path):
    one = judge(truth=False, detectors=('cdt', 'sdt'), namespaces=True,
                operating_points=('nominal', 'matched'))
    assert one.topics == ['cdt/detections', 'cdt/tracks', 'sdt/detections', 'sdt/tracks']
    for k in (1, 2):
        for topic in one.topics:
            one.add_array(topic, k * SECOND, [entry()] * k * ('cdt' in topic), float(k))
    assert [judged.number for judged in one.score()] == [1, 2]
    one.write_summary()
    summary = json.loads((tmp_path / 'run' / 'summary.json').read_text())
    assert summary['frames'] == {'published': 2, 'scored': 2, 'unanswered': 0, 'unseen': 0}
    assert summary['detectors']['cdt']['operating_point'] == 'nominal'
    for name, declared in (('cdt', 3), ('sdt', 0)):
        for level in ('detection', 'tracking'):
            figures = summary['detectors'][name][level]
            known = {key for key, value in figures.items() if value is not None}
            assert known == {
                'unanswered', 'frames_without_truth', 'declared', 'hits_with_velocity'}
            assert (figures['frames_without_truth'], figures['declared']) == (2, declared)
    assert [row[4:] for row in rows(tmp_path / 'run')] == [
        ['', str(k * (n < 2)), '', '', '', '', '', '0', '', ''] for k in (1, 2) for n in range(4)]
    text = format_table(summary)
    assert 'cdt: 2 frames without truth, in which 3 detections and 3 tracks were declared' in text
    assert 'None' not in text


def test_answers_without_their_truth_are_refused_by_stamp(judge):
    one = judge()
    for topic in ('detections', 'tracks'):
        one.add_array(topic, SECOND, [], 1.0)
    for topic in one.topics:
        one.add_array(topic, 2 * SECOND, [], 2.0)
    assert [judged.stamp for judged in one.score()] == [2 * SECOND]
    assert one.refused == ['answers to stamp 1 s, of which no truth came']


def test_frame_that_waited_too_long_is_unanswered(judge, tmp_path):
    one = judge()
    one.add_array(TRUTH, SECOND, [], 1.0)
    assert one.score(older_than_s=0.5) == []
    assert len(one.score(older_than_s=1.5)) == 1
    one.write_summary()
    summary = json.loads((tmp_path / 'run' / 'summary.json').read_text())
    assert summary['frames'] == {'published': 1, 'scored': 0, 'unanswered': 1, 'unseen': 0}
    assert [row[5:] for row in rows(tmp_path / 'run')] == [[''] * 9] * 2


SHIFTS = (9.0, 0.1, 0.2, 0.4, 0.3, 0.8)


def broken_run(judge, folder, checkpoint):
    """Score six frames in two lives, the first of which ends while it writes the fifth."""
    first = judge(folder.name)
    for k, shift in enumerate(SHIFTS[:4], start=1):
        answer(first, k, shift)
        first.score()
        if k == {'early': 2, 'late': 4, 'damaged': 4}.get(checkpoint):
            first.settle()
    if checkpoint == 'damaged':
        (folder / 'checkpoint.json').write_text('{"ends": [')
    with (folder / 'frames.csv').open('a') as file:
        file.write('5,5.0,sdt,detection,1,2,1')
    second = judge(folder.name, resumed=True)
    assert second.number == second.published == 4
    for k, shift in enumerate(SHIFTS[4:], start=5):
        answer(second, k, shift)
        second.score()
    second.settle()


def figures(folder):
    """Return the summary's figures, without null and flat."""
    summary = json.loads((folder / 'summary.json').read_text())
    chain = summary['detectors']['sdt']
    return summary['frames'] | {
        (level, name): value for level in ('detection', 'tracking')
        for name, value in chain[level].items() if isinstance(value, (int, float))
    } | {('latency', name): value for name, value in chain['latency_ms'].items()}


@pytest.mark.parametrize('checkpoint', ['none', 'early', 'late', 'damaged'])
def test_a_second_life_goes_on_from_what_the_first_had_scored(judge, tmp_path, checkpoint):
    broken, unbroken = tmp_path / 'broken', tmp_path / 'unbroken'
    broken_run(judge, broken, checkpoint)
    other = judge('unbroken')
    for k, shift in enumerate(SHIFTS, start=1):
        answer(other, k, shift)
        other.score()
    other.settle()
    for name in ('frames.csv', 'latency.csv'):
        assert (broken / name).read_bytes() == (unbroken / name).read_bytes()
    assert len(figures(broken)) > 30
    # frames.csv has nine digits, latency.csv three behind the point.
    assert figures(broken) == pytest.approx(figures(unbroken), rel=1e-5)


def test_a_second_life_refuses_what_the_first_has_answered(judge):
    first = judge()
    answer(first, 1, 0.1)
    first.score()
    second = judge(resumed=True)
    assert not second.add_array('tracks', SECOND, [], 9.0)
    assert second.add_array('tracks', 2 * SECOND, [], 9.0)


def test_a_table_that_no_evaluator_wrote_is_named(judge, tmp_path):
    (tmp_path / 'run').mkdir()
    (tmp_path / 'run' / 'frames.csv').write_text('1,2,3\n1,2,3\n')
    with pytest.raises(ValueError, match=r"frames\.csv: '1,2,3' is not a line of this table"):
        judge(resumed=True)


@pytest.mark.parametrize(('node', 'scored'), [
    ('/sdt_detector', True), ('/tracker', False), ('/viewer', False), ('/cdt_detector', False)])
def test_nothing_is_expected_of_a_node_that_was_started_again(judge, node, scored):
    one = judge()
    one.add_array(TRUTH, SECOND, [], 10.0)
    one.add_array(TRUTH, 2 * SECOND, [], 12.0)
    one.expect_no_more(node, 11.0)
    judged = one.score()
    assert [item.stamp for item in judged] == [SECOND] * scored
    assert all(item.answers['sdt'].detections is None for item in judged)


def test_a_tracker_started_again_leaves_the_detections_to_be_scored(judge):
    one = judge()
    one.add_array(TRUTH, SECOND, [], 10.0)
    one.expect_no_more('/tracker', 11.0)
    assert one.score() == []
    one.add_array('detections', SECOND, [entry()], 11.5)
    (judged,) = one.score()
    assert len(judged.answers['sdt'].detections) == 1
    assert judged.answers['sdt'].tracks is None
