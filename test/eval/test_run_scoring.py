# SPDX-License-Identifier: Apache-2.0
"""Scoring from messages: with truth, without, and what is written of it."""

from pathlib import Path

from disk import fill
from lowsnr_bringup.run.results_folder import Account
from lowsnr_common.core.records import Estimate
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.report.table import format_table
from lowsnr_eval.scoring.final_summary import summarize
from lowsnr_eval.scoring.frame_join import Arrival
from lowsnr_eval.scoring.run_scoring import NO_TRUTH
from lowsnr_eval.scoring.run_scoring import RunScorer
from lowsnr_eval.scoring.run_scoring import TRUTH
import numpy as np
import pytest

SECOND = 1_000_000_000
STATE = np.array([3.0, 0.0, 2.0, 0.0])


def entry(shift=0.0, name=''):
    return Estimate(STATE + shift, np.zeros((4, 4)), 1.0, name)


class Scorer(RunScorer):
    """A scorer with the reasons of what it rejects, and its summary."""

    def __init__(self, folder, resumed=False, **settings):
        self.settings = RunSettings(results=str(folder), scenario='s', **settings)
        self.rejected = []
        super().__init__(
            self.settings, Evaluation(), lambda *why: self.rejected.append(why), resumed)

    def summary(self):
        return summarize(Path(self.settings.results), self.settings, Evaluation(), 4,
                         Account(self.ledger))


@pytest.fixture
def scorer(tmp_path):
    """Return a function that makes a scorer."""
    made = []

    def make(folder='run', **settings):
        made.append(Scorer(tmp_path / folder, **settings))
        return made[-1]

    yield make
    for item in made:
        item.close()


def answer(one, k, shift):
    """Let an object and an answer near it be in frame k."""
    one.add_state(TRUTH, k * SECOND, entry(name='an object'))
    one.add_array(TRUTH, k * SECOND, [entry(name='an object')], float(k))
    one.add_array('detections', k * SECOND, [entry(shift), entry(9.0)], k + 0.1)
    one.add_state('tracks', k * SECOND, entry(shift, '1'))
    one.add_array('tracks', k * SECOND, [entry(shift, '1')], k + 0.2)


def rows(folder):
    return [line.split(',') for line in (folder / 'frames.csv').read_text().splitlines()[1:]]


def test_frame_is_scored_when_all_chains_have_answered(scorer, tmp_path):
    one = scorer()
    assert one.topics == [TRUTH, 'detections', 'tracks']
    one.add_state(TRUTH, SECOND, entry(name='a'))
    one.add_array(TRUTH, SECOND, [entry(name='a')], 10.0)
    one.add_array('detections', SECOND, [entry(0.1), entry(9.0)], 10.1)
    assert one.score() == []
    one.add_array('tracks', SECOND, [], 10.25)
    (scored,) = one.score()
    assert (scored.stamp, scored.number) == (SECOND, 1)
    assert scored.answers['sdt'].latency_ms == pytest.approx(250.0)
    assert scored.answers['sdt'].detection_ms == pytest.approx(100.0)
    assert [row[4:8] for row in rows(tmp_path / 'run')] == [
        ['1', '2', '1', '1'], ['1', '0', '0', '0']]
    assert one.add_array('tracks', SECOND, [], 11.0) is Arrival.LATE


def test_without_truth_only_declarations_are_counted(scorer, tmp_path):
    one = scorer(
        truth=False, detectors=('cdt', 'sdt'), namespaces=True,
        operating_points=('nominal', 'matched'))
    assert one.topics == ['cdt/detections', 'cdt/tracks', 'sdt/detections', 'sdt/tracks']
    for k in (1, 2):
        for topic in one.topics:
            one.add_array(topic, k * SECOND, [entry()] * k * ('cdt' in topic), float(k))
    assert [scored.number for scored in one.score()] == [1, 2]
    summary = one.summary()
    assert summary['frames'] == {
        'expected': None, 'published': 2, 'scored': 2, 'unanswered': 0, 'unseen': 0, 'lost': 0}
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


def test_frame_without_its_truth_is_rejected_with_a_reason(scorer):
    one = scorer()
    for topic in ('detections', 'tracks'):
        one.add_array(topic, SECOND, [], 1.0)
    for topic in one.topics:
        one.add_array(topic, 2 * SECOND, [], 2.0)
    assert [scored.stamp for scored in one.score()] == [2 * SECOND]
    (sentence, reason), = one.rejected
    assert reason == NO_TRUTH
    assert ' 1.000000000 s ' in sentence


def test_frame_that_waited_too_long_is_unanswered(scorer, tmp_path):
    one = scorer()
    one.add_array(TRUTH, SECOND, [], 1.0)
    assert one.score(older_than_s=0.5) == []
    assert len(one.score(older_than_s=1.5)) == 1
    summary = one.summary()
    assert summary['frames'] == {
        'expected': None, 'published': 1, 'scored': 0, 'unanswered': 1, 'unseen': 0, 'lost': 0}
    assert [row[5:] for row in rows(tmp_path / 'run')] == [[''] * 9] * 2


SHIFTS = (9.0, 0.1, 0.2, 0.4, 0.3, 0.8)


def score_all(one, shifts, first=1):
    """Score a frame for each shift of the estimates from the object."""
    for k, shift in enumerate(shifts, start=first):
        answer(one, k, shift)
        one.score()


@pytest.fixture
def unbroken(scorer, tmp_path):
    """Return the folder and the summary of six frames that one process scored."""
    one = scorer('unbroken')
    score_all(one, SHIFTS)
    return tmp_path / 'unbroken', one.summary()


def cut(path, count):
    """Cut bytes off the end of a file."""
    path.write_bytes(path.read_bytes()[:-count])


# How the first process left its tables after it had scored four frames, and the last whole one.
DEATHS = {
    'between two frames': (lambda folder: None, 4),
    'within a line': (lambda folder: cut(folder / 'frames.csv', 10), 3),
    'between two lines': (lambda folder: cut(folder / 'frames.csv', len(
        (folder / 'frames.csv').read_text().splitlines()[-1]) + 1), 3),
    'before the latency was written': (lambda folder: cut(folder / 'latency.csv', 5), 4),
}


@pytest.mark.parametrize('death', DEATHS)
def test_restarted_evaluator_continues_the_tables(scorer, tmp_path, unbroken, death):
    leave, whole = DEATHS[death]
    broken, (folder, summary) = tmp_path / 'broken', unbroken
    score_all(scorer('broken'), SHIFTS[:4])
    leave(broken)
    second = scorer('broken', resumed=True)
    assert second.number == second.ledger.published == whole
    # A tracker that is late gets no second line for a frame that was scored.
    assert second.add_array('tracks', whole * SECOND, [], 9.0) is Arrival.LATE
    score_all(second, SHIFTS[whole:], whole + 1)
    for name in ('frames.csv', 'detections.csv', 'tracks.csv', 'truth.csv'):
        assert (broken / name).read_bytes() == (folder / name).read_bytes()
    ours = second.summary()
    if death == 'before the latency was written':  # one value is gone
        for each in (ours, summary):
            for key in ('latency_ms', 'detection_latency_ms'):
                assert each['detectors']['sdt'].pop(key)['median'] > 0.0
    else:
        assert (broken / 'latency.csv').read_bytes() == (folder / 'latency.csv').read_bytes()
    assert ours == summary


def test_evaluator_that_died_before_its_first_frame_begins_again(scorer, tmp_path):
    scorer()
    cut(tmp_path / 'run' / 'frames.csv', 20)
    second = scorer(resumed=True)
    assert (second.number, second.ledger.published) == (0, 0)
    score_all(second, SHIFTS[:1])
    assert [row[0] for row in rows(tmp_path / 'run')] == ['1', '1']


@pytest.mark.parametrize('text', ['1,2,3\n1,2,3\n', 'x\n'])
def test_table_that_no_evaluator_wrote_is_named(scorer, tmp_path, text):
    (tmp_path / 'run').mkdir()
    (tmp_path / 'run' / 'frames.csv').write_text(text)
    with pytest.raises(ValueError) as caught:
        scorer(resumed=True)
    assert str(caught.value).startswith(str(tmp_path / 'run' / 'frames.csv'))
    assert (tmp_path / 'run' / 'frames.csv').read_text() == text


@pytest.mark.parametrize(('node', 'scored'), [
    ('/sdt_detector', True), ('/conditioner', True), ('/tracker', False), ('/viewer', False),
    ('/cdt_detector', False)])
def test_frame_does_not_wait_for_a_node_that_was_restarted(scorer, node, scored):
    one = scorer()
    one.add_array(TRUTH, SECOND, [], 10.0)
    one.add_array(TRUTH, 2 * SECOND, [], 12.0)
    one.expect_no_more(node, 11.0)
    done = one.score()
    assert [item.stamp for item in done] == [SECOND] * scored
    assert all(item.answers['sdt'].detections is None for item in done)


def test_detections_are_scored_where_the_tracker_was_restarted(scorer):
    one = scorer()
    one.add_array(TRUTH, SECOND, [], 10.0)
    one.add_array('detections', SECOND, [entry()], 10.5)
    assert one.score() == []
    one.expect_no_more('/tracker', 11.0)
    (scored,) = one.score()
    assert len(scored.answers['sdt'].detections) == 1
    assert scored.answers['sdt'].tracks is None


def test_scene_gives_its_room_to_the_scores(scorer, small_disk):
    one = scorer(small_disk / 'run')
    files = [small_disk / 'run' / name for name in ('frames.f32', 'scene.jsonl')]
    for k in range(1, 100):
        one.scene.add_frame(k * SECOND, np.zeros((20, 20)))
        answer(one, k, 0.1)
        one.score()
    fill(small_disk / 'ballast')
    assert all(file.stat().st_size for file in files)
    for k in range(100, 200):
        answer(one, k, 0.1)
        one.score()
    assert len(rows(small_disk / 'run')) < 2 * 199
    assert one.flush() is None
    assert [file.stat().st_size for file in files] == [0, 0]
    assert len(rows(small_disk / 'run')) == 2 * 199
    assert len(one.scene._answers) == 0  # it takes no more
