# SPDX-License-Identifier: Apache-2.0
"""What must hold of a run after faults."""

import signal

from graph_client import FUTURE_S

# A node that died is back within this time on a busy machine too [s]: until then the frame that
# it had in hand is awaited, and in lockstep no other is sent.
PATIENT = ('--set', 'evaluator.answer_within_s=40')


def check_end(run, code):
    """Check a run's exit code, that nothing of it is left, and that no node raised."""
    status, out, err = run.finish()
    assert status == code, err
    run.wait_until_none_is_left()
    texts = [out, err, *(path.read_text() for path in (run.results / 'log').iterdir())]
    assert not [text for text in texts if 'Traceback' in text]
    return out


def interrupt(run):
    """End a run by Ctrl-C; return the number of rows that were scored before."""
    lines = len(run.rows())
    run.process.send_signal(signal.SIGINT)
    return lines


def check_none_lost(run, chains=1):
    """Check that the table holds what the summary says, and return that."""
    frames, rows = run.summary()['frames'], run.rows()
    table = frames['scored'] + frames['unanswered']
    assert [int(row.split(',')[0]) for row in rows] == [
        number for number in range(1, table + 1) for _ in range(2 * chains)]
    assert frames['published'] == table + frames['unseen']
    assert (frames['lost'], min(frames['unseen'], 0)) == (0, 0)
    return frames


def check_cut_off(run, under_way=1, chains=1):
    """
    Check that an interrupted run lacks the answers to the frames that were under way alone.

    They are the last frames of its table, or follow it.  In lockstep `under_way` is 1, and the lag
    more; of a paced run it is None, as there may be any number on a busy machine.
    """
    frames = check_none_lost(run, chains)
    if under_way is not None:
        assert 0 <= frames['unanswered'] + frames['unseen'] <= under_way
    cut_off = {int(row.split(',')[0]) for row in run.rows() if not row.split(',')[5]}
    assert cut_off == {frames['scored'] + n for n in range(1, frames['unanswered'] + 1)}


def check_frames(run, lines, loose=3):
    """
    Check that every frame of the source is scored, and that at most `loose` have no answer.

    The stamps of the source are whole seconds.  The end of a loop leaves frames on their way, so
    that only frames in the first `lines` rows must have an answer.
    """
    rows = [row.split(',') for row in run.rows()]
    answered = {}
    for row in rows:
        if float(row[1]).is_integer():
            answered[int(float(row[1]))] = answered.get(int(float(row[1])), True) and bool(row[5])
    assert sorted(answered) == list(range(1, len(answered) + 1))
    frames = run.summary()['frames']
    strangers = sum(not float(row[1]).is_integer() for row in rows) // 2
    assert frames['published'] + strangers == (
        frames['scored'] + frames['unanswered'] + frames['unseen'] + frames['lost'])
    assert frames['published'] >= len(answered)
    early = {float(row[1]) for row in rows[:lines]}
    silent = [stamp for stamp, found in answered.items() if not found and stamp in early]
    assert len(silent) <= loose, silent
    return len(answered)


def wait_for_all_scored(run, client):
    """Wait until the evaluator has scored all frames that the source has published by now."""
    newest = client.newest_s('/image_raw')
    client.wait(lambda: run.rows() and float(run.rows()[-1].split(',')[1]) > newest)


def first_answer_after(run, stamp_s):
    """Return the number of the first row in which a frame after a time has tracks; 0 if none."""
    rows = [row.split(',') for row in run.rows()]
    return next((n for n, row in enumerate(rows, start=1) if float(row[1]) > stamp_s
                 and float(row[1]) < FUTURE_S and row[3] == 'tracking' and row[5]), 0)


def check_lost_at_death(run):
    """
    Check that frames without an answer are those that were under way when a node died.

    In a paced run on a busy machine there may be any number of them, but they are consecutive.
    """
    died, = (int(row['frame']) for row in run.restarts())
    rows = [row.split(',') for row in run.rows()[::2]]
    unanswered = [int(row[0]) for row in rows if not row[5]]
    first = min(unanswered, default=died + 1)
    assert first > died
    assert unanswered == list(range(first, first + len(unanswered)))
    assert len(rows) - first - len(unanswered) > 100
