# SPDX-License-Identifier: Apache-2.0
"""Where the frames of a run go: the ledger agrees with what became of each frame."""

from contextlib import contextmanager
from pathlib import Path
import resource
import tempfile

from hypothesis import given
from hypothesis import settings
from hypothesis import strategies as st
from lowsnr_bringup.run.frame_ledger import FrameLedger
from lowsnr_bringup.run.results_folder import Account
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.scoring.final_summary import missing_frames
from lowsnr_eval.scoring.final_summary import summarize
from lowsnr_eval.scoring.run_scoring import RunScorer
from lowsnr_eval.scoring.run_scoring import TRUTH
import pytest

SECOND = 1_000_000_000
# What becomes of a frame that the source publishes.
FATES = ('answered', 'unanswered', 'not received', 'half received')
EVENTS = st.lists(
    st.one_of(
        st.sampled_from(FATES), st.sampled_from(FATES[:1]),
        st.sampled_from(('disk full', 'disk has room', 'killed', 'killed unannounced', 'ended',
                         'clock late', 'table removed'))),
    min_size=1, max_size=40)


@contextmanager
def no_file_grows(beyond):
    """Let the system refuse to write beyond a size [bytes]; what fits of a line is written."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (beyond, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


class Run:
    """A run: its scorer on a disk that may be full, the ledger, and the fate of each frame."""

    def __init__(self, folder, camera=False):
        self.table, self.stamp = folder / 'frames.csv', 0
        self.camera, self.ledger = camera, FrameLedger(told=not camera)
        self.run = RunSettings(results=str(folder), scenario='s')
        self.published, self.known = [], set()  # known: announced, or in the table by then
        self.late = []  # publications that the ledger has not been told of
        self.silent = self.delayed = False
        self.room = -1  # of a file [bytes]
        self.scorer = self.new_scorer(False)

    def new_scorer(self, resumed):
        return RunScorer(self.run, Evaluation(), lambda *_: None, resumed)

    def happen(self, event):
        """Let something happen."""
        if event in FATES:
            self.send(event)
        elif event.startswith('disk'):
            self.room = self.table.stat().st_size + 30 if event == 'disk full' else -1
        elif event == 'clock late':
            self.delayed = True
        else:
            self.restart(event)

    def send(self, fate):
        """Publish a frame, and let what arrives of it be scored."""
        self.stamp += SECOND
        self.published.append(self.stamp)
        self.late.append(self.stamp)
        if not self.delayed:
            self.tell()
        received = {'answered': (TRUTH, 'detections', 'tracks'), 'unanswered': (TRUTH,),
                    'half received': ('tracks',), 'not received': ()}[fate]
        for topic in received:
            self.scorer.add_array(topic, self.stamp, [], self.stamp / 1e9)
        self.score()
        self.tell()

    def tell(self):
        """Tell the ledger of what was published; a camera tells nobody."""
        for stamp in self.late if not self.camera else ():
            self.ledger.publish(stamp)
        self.late.clear()
        self.delayed = False

    def score(self, older_than_s=-float('inf')):
        """Score what is complete, and announce it unless the evaluator dies before it can."""
        with no_file_grows(self.room):
            done = self.scorer.score(older_than_s)
        for scored in done:
            if not self.silent:
                self.known |= {scored.stamp, *self.stamps()}
                self.ledger.score(scored.stamp, scored.number)

    def restart(self, event):
        """End the evaluator in some way and start it again."""
        if event == 'ended':
            self.score(float('inf'))
            self.close()
        elif event == 'killed unannounced':
            self.silent = True
            self.score(float('inf'))
        for file in (self.scorer.tables._frames._file, self.scorer.tables._latency._file,
                     *(table._file for table in self.scorer.entries._files),
                     self.scorer.scene._lines, self.scorer.scene._pixels):
            file.close()  # as the end of the process does
        self.silent = False
        if event == 'table removed':
            self.table.unlink()
            self.room = -1
        self.scorer = self.new_scorer(True)

    def close(self):
        """Close the results."""
        with no_file_grows(self.room):
            self.scorer.close()

    def end(self):
        """End the run; return what its summary says of the frames."""
        self.tell()
        self.score(float('inf'))
        self.close()
        return summarize(
            self.table.parent, self.run, Evaluation(), 0, Account(self.ledger))['frames']

    def stamps(self):
        """Return the stamps of the frames that the table holds whole."""
        lines = self.table.read_text().rpartition('\n')[0].splitlines()[1:]
        return {round(float(line.split(',')[1]) * SECOND) for line in lines[1::2]}


@settings(max_examples=150, deadline=None, derandomize=True)
@given(events=EVENTS)
def test_every_published_frame_is_accounted_for(events):
    with tempfile.TemporaryDirectory() as folder:
        run = Run(Path(folder))
        for event in events:
            run.happen(event)
        frames, table = run.end(), run.stamps()
    published = set(run.published)
    assert frames['published'] == len(published)
    assert frames['scored'] + frames['unanswered'] == len(table)
    lost, unseen = len(run.known - table), len(published - run.known - table)
    assert frames['lost'] + frames['unseen'] == lost + unseen
    if 'killed unannounced' not in events:  # whose rows may take the numbers of those lost before
        assert (frames['lost'], frames['unseen']) == (lost, unseen)
    assert bool(missing_frames(frames)) != (table == published)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(events=EVENTS)
def test_every_frame_of_a_camera_that_the_evaluator_wrote_is_accounted_for(events):
    with tempfile.TemporaryDirectory() as folder:
        run = Run(Path(folder), camera=True)
        for event in events:
            run.happen(event)
        frames, table = run.end(), run.stamps()
    assert frames['scored'] + frames['unanswered'] == len(table)
    assert frames['published'] == len(table) + frames['lost']
    assert frames['unseen'] == 0
    if 'killed unannounced' not in events:  # whose rows may take the numbers of those lost before
        assert frames['lost'] == len(run.known - table)
    assert bool(missing_frames(frames)) == bool(frames['lost'])


def test_frames_of_a_camera_written_while_the_evaluator_ends_count_as_published():
    ledger = FrameLedger(told=False)
    for k in range(1, 4):
        ledger.score(k, k)
    ledger.close(8, 8)  # five more were written, and none announced
    assert (ledger.published, ledger.unseen, ledger.lost) == (8, 0, 0)


def test_a_count_that_is_wrong_is_named():
    ledger = FrameLedger()
    ledger.publish(SECOND)
    ledger.score(SECOND, 1)
    ledger.score(2 * SECOND, 2)  # nobody published it
    ledger.close(2, 2)
    frames = {'expected': 1, 'published': ledger.published, 'scored': 2, 'unanswered': 0,
              'unseen': ledger.unseen, 'lost': ledger.lost}
    assert (frames['published'], frames['unseen'], frames['lost']) == (1, 0, 0)
    fault, = missing_frames(frames)
    assert '1 published, 2 in frames.csv' in fault


@pytest.mark.parametrize(('changed', 'faults'), [
    ({}, 0), ({'expected': None}, 0), ({'expected': 6}, 1), ({'lost': 1, 'scored': 3}, 1),
    ({'unseen': 1, 'scored': 3}, 1), ({'unseen': -1, 'scored': 5}, 2), ({'scored': 3}, 1)])
def test_what_is_missing_has_a_line_for_each_kind(changed, faults):
    frames = {'expected': 5, 'published': 5, 'scored': 4, 'unanswered': 1, 'unseen': 0, 'lost': 0}
    assert len(missing_frames(frames | changed)) == faults


def test_frames_that_were_dropped_within_the_table_are_lost():
    ledger = FrameLedger()
    for k in range(1, 6):
        ledger.publish(k)
        ledger.score(k, k)
    ledger.close(3, 5)  # those between waited for room when too many did
    assert (ledger.published, ledger.unseen, ledger.lost) == (5, 0, 2)


@pytest.mark.parametrize(('scored', 'total', 'unseen'), [(1, 1, 0), (2, 3, 1), (3, 2, 0)])
def test_frames_that_were_scored_and_whose_publication_was_not_heard_are_not_unseen(
        scored, total, unseen):
    ledger = FrameLedger()
    for k in range(1, scored + 1):
        ledger.score(k, k)
    ledger.publish_unheard(total)
    ledger.close(scored, scored)
    assert (ledger.published, ledger.unseen, ledger.lost) == (total, unseen, 0)


def test_an_old_summary_is_read():
    assert missing_frames({'published': 5, 'scored': 4, 'unanswered': 1, 'unseen': 0}) == []


def test_memory_of_the_ledger_does_not_grow_with_the_run():
    ledger = FrameLedger()
    for k in range(1, 1001):
        ledger.publish(k)
        if k % 7:
            ledger.score(k, ledger._number + 1)
        assert len(ledger._awaited) + len(ledger._early) <= 1
    ledger.close(858, 858)
    assert (ledger.published, ledger.unseen, ledger.lost) == (1000, 142, 0)
