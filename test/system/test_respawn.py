# SPDX-License-Identifier: Apache-2.0
"""Nodes that die are started again: every frame is scored, unanswered or unseen, none is lost."""

import contextlib
import functools
import json
import os
from pathlib import Path
import signal
import time

from graph_runs import own_domain
from graph_runs import start_bringup
import numpy as np
import pytest
from run_checks import check_end
from run_checks import check_lost_at_death
from run_checks import PATIENT
from tally import FAULTS

NODES = ('sensor_node', 'detector_node', 'tracker_node', 'evaluator_node')
LABELS = {'detector_node': 'cdt_detector'}
DEATHS = 8
LOCKSTEP = ('--detector', 'cdt', '--scenario', 'example3', '--snr', '12', '--loop', '--lockstep',
            *PATIENT)


def end_a_node(run, module, number):
    """End a node and wait until it is back and frames are scored again."""
    before = len(run.restarts())
    run.kill(module, number)
    FAULTS[f'{module} ended'] += 1
    run.wait_for_restarts(before + 1)
    run.wait_for_rows(len(run.rows()) + 20)


def check_account(run, lost_at_most):
    """Check that every frame is accounted for, and how many were not scored."""
    frames = run.summary()['frames']
    assert frames['published'] == frames['scored'] + frames['unanswered'] + frames['unseen']
    assert frames['unanswered'] + frames['unseen'] <= lost_at_most
    assert len(run.rows()) == 2 * (frames['published'] - frames['unseen'])
    numbers = [int(row.split(',')[0]) for row in run.rows()[::2]]
    assert numbers == list(range(1, len(numbers) + 1))
    stamps = [float(row.split(',')[1]) for row in run.rows()[::2]]
    assert stamps == sorted(set(stamps))
    assert frames['published'] >= stamps[-1]  # frame k is at k s
    for log in (run.results / 'log').iterdir():
        assert 'Traceback' not in log.read_text(), log


@pytest.fixture(scope='module')
def survivor(tmp_path_factory):
    """Return a function that ends each node of a run by a signal, and returns run and outcome."""
    @functools.cache
    def survive(number):
        with start_bringup(
                tmp_path_factory.mktemp('survivor') / 'run', *LOCKSTEP,
                domain_id=own_domain()) as run:
            run.wait_for_rows(100)
            for module in NODES:
                end_a_node(run, module, number)
            run.wait_for_rows(len(run.rows()) + 200)
            run.process.send_signal(signal.SIGINT)
            ended = run.finish()
            run.wait_until_none_is_left()
            return run, *ended
    return survive


@pytest.mark.parametrize('number', [
    pytest.param(signal.SIGKILL, id='SIGKILL'),
    pytest.param(signal.SIGTERM, id='SIGTERM', marks=pytest.mark.slow)])
def test_every_node_comes_back(survivor, number):
    run, code, out, _ = survivor(number)
    assert code == 130
    labels = [LABELS.get(module, module.removesuffix('_node')) for module in NODES]
    restarts = run.restarts()
    assert [row['node'] for row in restarts] == labels
    assert all(number.name in row['death'] for row in restarts)
    assert run.summary()['restarts'] == dict.fromkeys(labels, 1)
    assert all(f'{label} 1 x' in out for label in labels)
    # In lockstep a node has one frame in hand when it dies; the last may be under way at the end.
    check_account(run, lost_at_most=len(NODES) + 1)


def test_any_node_may_die_at_any_frame(bringup):
    rng = np.random.default_rng(3)
    run = bringup('--detector', 'cdt', 'sdt', '--loop', '--lockstep', *PATIENT)
    run.wait_for_rows(40)
    for number in range(DEATHS):
        run.wait_for_rows(len(run.rows()) + 4 * int(rng.integers(1, 20)))
        modules = sorted(run.processes())
        module, pid = modules[rng.integers(len(modules))]
        os.kill(pid, (signal.SIGKILL, signal.SIGTERM)[rng.integers(2)])
        FAULTS[f'{module} ended'] += 1
        run.wait_for_restarts(number + 1)
    run.wait_for_rows(len(run.rows()) + 40)
    run.process.send_signal(signal.SIGINT)
    check_end(run, 130)
    frames = run.summary()['frames']
    assert frames['published'] == frames['scored'] + frames['unanswered'] + frames['unseen']
    assert frames['unanswered'] + frames['unseen'] <= DEATHS + 1
    assert sum(run.summary()['restarts'].values()) == DEATHS
    assert len(run.rows()) == 4 * (frames['scored'] + frames['unanswered'])
    assert frames['published'] >= float(run.rows()[-1].split(',')[1])  # frame k is at k s


def test_killed_detector_loses_the_frames_that_it_held_for_their_late_answers(bringup):
    lag = 3
    run = bringup(
        '--detector', 'hmm', '--scenario', 'example3', '--snr', '12', '--loop', '--lockstep',
        '--set', f'hmm.lag={lag}', '--set', 'hmm.operating_point=nominal', '--set', 'hmm.order=1',
        *PATIENT)
    run.wait_for_rows(40)
    for module in ('detector_node', 'tracker_node', 'evaluator_node'):
        end_a_node(run, module, signal.SIGKILL)
    run.process.send_signal(signal.SIGINT)
    check_end(run, 130)
    # So many frames are under way when a node dies, and at the end.
    check_account(run, lost_at_most=4 * (lag + 1))
    empty = [row.split(',')[3] for row in run.rows() if not row.split(',')[5]]
    # The tracker lost the frame that it had in hand at most; the end leaves some unanswered too.
    assert lag <= empty.count('detection') <= 3 * (lag + 1)
    # A detector that dies while it sends may have reached the evaluator and not the tracker, and
    # the last frame may be under way between them at the end.
    assert empty.count('tracking') <= empty.count('detection') + 3


def test_nodes_killed_while_the_graph_starts_are_started_again(bringup):
    rng = np.random.default_rng(4)
    run = bringup(*LOCKSTEP)
    for module in rng.permutation(NODES):
        until = time.monotonic() + 120.0
        while module not in run.nodes():
            assert time.monotonic() < until
            time.sleep(0.005)
        time.sleep(float(rng.uniform(0.0, 0.2)))
        run.kill(module)
        FAULTS[f'{module} killed while the graph starts'] += 1
    run.wait_for_rows(len(run.rows()) + 40)
    run.process.send_signal(signal.SIGINT)
    check_end(run, 130)
    assert sorted(row['node'] for row in run.restarts()) == sorted(
        LABELS.get(module, module.removesuffix('_node')) for module in NODES)
    check_account(run, lost_at_most=len(NODES) + 1)


def test_nodes_share_no_memory_that_a_killed_one_could_leave_locked(bringup):
    run = bringup(*LOCKSTEP)
    run.wait_for_rows(20)
    for pid in [run.process.pid, *run.nodes().values()]:
        mapped = Path(f'/proc/{pid}/maps').read_text()
        assert 'libfastrtps' in mapped
        assert '/dev/shm/fastrtps' not in mapped


def test_a_node_killed_while_frames_are_sent_comes_back(bringup, tmp_path):
    scenario = tmp_path / 'large.yaml'
    scenario.write_text('{frames: 100, rows: 600, cols: 500, snr_db: 12.0, objects: []}')
    run = bringup('--detector', 'cdt', '--scenario', str(scenario), '--loop', '--lockstep',
                  *PATIENT)
    run.wait_for_rows(20)
    for module in ('sensor_node', 'detector_node'):  # sends, receives
        for _ in range(2):
            end_a_node(run, module, signal.SIGKILL)
    run.process.send_signal(signal.SIGINT)
    check_end(run, 130)
    check_account(run, lost_at_most=5)


def test_ids_of_tracks_are_not_used_again(survivor):
    run, *_ = survivor(signal.SIGKILL)
    lines = [json.loads(line) for line in (run.results / 'scene.jsonl').read_text().splitlines()]
    ids = [{mark[2] for mark in line['chains']['cdt']['tracks'] or ()} for line in lines]
    killed, = (int(row['frame']) for row in run.restarts() if row['node'] == 'tracker')
    before, after = set().union(*ids[:killed]), set().union(*ids[killed + 1:])
    assert before
    assert after
    assert not before & after


def test_a_node_that_always_dies_ends_the_run(bringup):
    run = bringup('--detector', 'cdt', '--loop', '--rate', '50')
    run.wait_for_rows(20)
    until = time.monotonic() + 240.0
    while run.process.poll() is None:
        assert time.monotonic() < until
        if (pid := run.nodes().get('tracker_node')) is not None:
            with contextlib.suppress(ProcessLookupError):  # the one before
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.02)
    code, _, err = run.finish()
    assert code == 1
    lines = [line for line in err.splitlines() if 'tracker' in line and 'SIGKILL' in line]
    assert len(lines) == 6
    assert {row['node'] for row in run.restarts()} <= {'tracker'}
    assert run.summary()['frames']['scored'] > 0
    run.wait_until_none_is_left()


def test_paced_run_counts_what_was_lost(bringup):
    run = bringup('--detector', 'cdt', '--loop', '--rate', '40')
    run.wait_for_rows(40)
    for module in ('evaluator_node', 'detector_node'):
        end_a_node(run, module, signal.SIGKILL)
    run.process.send_signal(signal.SIGINT)
    code, out, _ = run.finish()
    assert code == 130
    frames = run.summary()['frames']
    assert frames['unseen'] > 0
    assert frames['unanswered'] > 0
    assert str(frames['unseen']) in out.split()
    check_account(run, lost_at_most=frames['published'])


def test_a_replay_goes_on_where_its_player_died(bringup, tmp_path):
    bag = tmp_path / 'bag'
    made = bringup('--detector', 'cdt', '--frames', '100', '--loop', '--rate', '100',
                   '--record', str(bag), results='made')
    made.wait_for_rows(2 * 200)
    made.process.send_signal(signal.SIGINT)
    assert made.finish()[0] == 130
    run = bringup('--detector', 'cdt', '--replay', str(bag), '--rate', '60', '--respawn')
    run.wait_for_rows(60)
    end_a_node(run, 'player_node', signal.SIGKILL)
    code, _, err = run.finish()
    assert code == 0, err
    # What was under way when the player died is lost, however much that was, and nothing else.
    published = made.summary()['frames']['published']
    check_account(run, lost_at_most=published)
    assert run.summary()['frames']['published'] == published
    check_lost_at_death(run)
