"""Scoring from messages: with truth, without, and what is written of it."""

import json

from lowsnr_eval.judge import Judge
from lowsnr_eval.judge import TRUTH
from lowsnr_eval.run_settings import RunSettings
from lowsnr_eval.scoring import Evaluation
from lowsnr_eval.table import format_table
from lowsnr_sensor.records import Estimate
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

    def make(**settings):
        refused = []
        made.append(Judge(
            RunSettings(results=str(tmp_path / 'run'), scenario='s', **settings), Evaluation(), 4,
            refused.append))
        made[-1].refused = refused
        return made[-1]

    yield make
    for item in made:
        item.__exit__(None, None, None)


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
    assert summary['frames'] == {'published': 2, 'scored': 2, 'unanswered': 0}
    assert summary['detectors']['cdt']['operating_point'] == 'nominal'
    for name, declared in (('cdt', 3), ('sdt', 0)):
        for level in ('detection', 'tracking'):
            figures = summary['detectors'][name][level]
            known = {key for key, value in figures.items() if value is not None}
            assert known == {
                'unanswered', 'frames_without_truth', 'declared', 'hits_with_velocity'}
            assert (figures['frames_without_truth'], figures['declared']) == (2, declared)
    assert [row[4:] for row in rows(tmp_path / 'run')] == [
        ['', str(k * (n < 2)), '', '', '', '', ''] for k in (1, 2) for n in range(4)]
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
    assert summary['frames'] == {'published': 1, 'scored': 0, 'unanswered': 1}
    assert [row[5:] for row in rows(tmp_path / 'run')] == [[''] * 6] * 2
