# SPDX-License-Identifier: Apache-2.0
"""Nodes that hang are named, and started again: in a run, while it starts, and at its end."""

import os
import select
import signal
import time

from graph_runs import own_domain
from graph_runs import start_bringup
import pytest
from run_checks import check_end
from tally import FAULTS

# The least time after which a node that gives no sign of life hangs.
WITHIN_S = 4.0
RUN = ('--detector', 'cdt', '--scenario', 'example3', '--loop', '--rate', '20', '--set',
       f'evaluator.answer_within_s={WITHIN_S}')
PATIENCE_S = 240.0


def stop(run, module):
    """Stop a node; return its process id."""
    pid = run.nodes()[module]
    os.kill(pid, signal.SIGSTOP)
    FAULTS[f'{module} hangs'] += 1
    return pid


def wait_until_said(run, words):
    """Wait until bring-up has printed something."""
    said, stream = '', run.process.stderr.fileno()
    until = time.monotonic() + PATIENCE_S
    while words not in said:
        ready, _, _ = select.select([stream], [], [], max(0.0, until - time.monotonic()))
        assert ready, said
        piece = os.read(stream, 4096).decode()
        assert piece, said
        said += piece


def answers(run):
    """Return what the tracker answered to each frame; an empty text for nothing."""
    rows = [row.split(',') for row in run.rows()]
    return [row[5] for row in rows if len(row) > 5 and row[3] == 'tracking']


@pytest.fixture(scope='module')
def hung(tmp_path_factory):
    """Return a run, its end, and the times of its start, its recovery and its end [s]."""
    start = time.monotonic()
    with start_bringup(tmp_path_factory.mktemp('hung') / 'run', *RUN, '--respawn',
                       domain_id=own_domain()) as run:
        run.wait_for_rows(40)
        times_s, start = [time.monotonic() - start], time.monotonic()
        tracker = stop(run, 'tracker_node')
        run.wait_for_restarts(1)
        assert run.nodes()['tracker_node'] != tracker
        while not all(answers(run)[-10:]):
            assert time.monotonic() < start + PATIENCE_S
            time.sleep(0.2)
        times_s.append(time.monotonic() - start)
        for module in ('detector_node', 'evaluator_node'):  # bring-up has them go on
            stop(run, module)
        run.process.send_signal(signal.SIGINT)
        start = time.monotonic()
        out = check_end(run, 130)
        return run, out, [*times_s, time.monotonic() - start]


def test_a_node_that_hangs_is_killed_and_started_again(hung):
    run, _, (_, back_s, _) = hung
    restart, = run.restarts()
    assert restart['node'] == 'tracker'
    assert 'stood still' in restart['death']
    frames = run.summary()['frames']
    assert frames['published'] == frames['scored'] + frames['unanswered'] + frames['unseen']
    # Those that came meanwhile, at 20 a second, and that were under way when it stopped.
    assert frames['unanswered'] < 20 * (back_s + WITHIN_S)
    assert not all(answers(run))


def test_nodes_that_are_stopped_when_a_run_ends_cost_no_score_and_little_time(hung):
    run, _, (starts_s, _, ends_s) = hung
    frames = run.summary()['frames']
    assert frames['scored'] + frames['unanswered'] == len(run.rows()) // 2
    assert frames['lost'] == 0
    # Two seconds for each of two nodes that stick, and what an end and its report take.
    assert ends_s < WITHIN_S + 4.0 * starts_s


def test_without_respawn_only_a_start_is_repaired_and_a_run_names_what_hangs(bringup):
    run = bringup(*RUN, '--no-respawn')
    until = time.monotonic() + PATIENCE_S
    while 'evaluator_node' not in run.nodes():
        assert time.monotonic() < until
        time.sleep(0.005)
    evaluator = stop(run, 'evaluator_node')
    run.wait_for_rows(40)
    assert run.nodes()['evaluator_node'] != evaluator
    tracker = stop(run, 'tracker_node')
    wait_until_said(run, 'bringup.py: tracker stood still')
    os.kill(tracker, signal.SIGCONT)
    wait_until_said(run, 'bringup.py: tracker reports again')
    run.process.send_signal(signal.SIGINT)
    assert run.finish()[0] == 130
    assert [row['node'] for row in run.restarts()] == ['evaluator']
    assert run.nodes() == {}
