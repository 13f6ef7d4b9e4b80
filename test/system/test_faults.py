# SPDX-License-Identifier: Apache-2.0
"""Nodes that die, Ctrl-C, and a bring-up that is gone: nothing is left, nothing is lost."""

import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from graph_client import GraphClient
from graph_runs import own_domain
from graph_runs import ROOT
from graph_runs import start_bringup
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
import psutil
import pytest
from run_checks import check_cut_off

FRAMES_BEFORE = 10


@pytest.mark.parametrize(
    'victim', ['sensor_node', 'detector_node', 'tracker_node', 'evaluator_node'])
def test_a_killed_node_is_named_and_ends_the_run(bringup, victim):
    run = bringup('--detector', 'cdt', '--loop', '--no-respawn', '--rate', '100')
    run.wait_for_rows(2 * FRAMES_BEFORE)
    os.kill(run.nodes()[victim], signal.SIGKILL)
    code, _, err = run.finish()
    label = {'detector_node': 'cdt_detector'}.get(victim, victim.removesuffix('_node'))
    assert code == 1
    assert [line for line in err.splitlines() if label in line and 'SIGKILL' in line]
    assert f'{label}.log' in err
    assert 'Traceback' not in err
    run.wait_until_none_is_left()
    assert len(run.rows()) >= 2 * FRAMES_BEFORE


def test_ctrl_c_keeps_scores_and_report(bringup):
    start_and_end(bringup, 'run')


@pytest.mark.slow
def test_ctrl_c_ends_a_run_in_bounded_time(bringup):
    starts_s, ends_s, reports_s = [], [], []
    for number in range(3):
        run, started_s, ended_s = start_and_end(bringup, f'run {number}')
        starts_s.append(started_s)
        ends_s.append(ended_s)
        reports_s.append(seconds_of_a_report(run))
    # The least of three, because other load on the machine only adds.  Besides stopping the nodes
    # the end writes summary and report, as evaluate.py does by itself.  An end that waits for a
    # node that does not answer takes several starts.
    assert min(ends_s) < 2.0 * min(starts_s) + min(reports_s)


def start_and_end(bringup, results):
    """Start a run and end it by Ctrl-C; return it, and how long start and end took [s]."""
    start = time.monotonic()
    run = bringup('--detector', 'cdt', '--loop', '--lockstep', results=results)
    run.wait_for_rows(2 * FRAMES_BEFORE)
    started = time.monotonic()
    run.process.send_signal(signal.SIGINT)
    code, out, err = run.finish()
    ended = time.monotonic()
    assert code == 130
    assert 'Traceback' not in out + err
    run.wait_until_none_is_left()
    frames = run.summary()['frames']
    assert frames['scored'] >= FRAMES_BEFORE
    check_cut_off(run)
    report = run.results / 'report.html'
    assert str(report) in out
    assert '<canvas' in report.read_text()
    return run, started - start, ended - started


def seconds_of_a_report(run):
    """Return how long a process of its own takes to write summary and report of a run [s]."""
    start = time.monotonic()
    subprocess.run(
        [sys.executable, 'scripts/evaluate.py', str(run.results)], cwd=ROOT, check=True,
        capture_output=True)
    return time.monotonic() - start


@pytest.fixture(scope='module')
def running(tmp_path_factory):
    """Return a run that goes on until somebody ends it."""
    with start_bringup(
            tmp_path_factory.mktemp('running') / 'run', '--detector', 'cdt', '--loop',
            '--rate', '50', domain_id=own_domain()) as run:
        run.wait_for_rows(2 * FRAMES_BEFORE)
        yield run


@pytest.mark.parametrize('claimed', [True, False], ids=['same TMPDIR', 'another TMPDIR'])
def test_second_run_on_the_same_domain_is_refused(
        running, bringup, tmp_path, monkeypatch, claimed):
    before = running.nodes()
    if not claimed:  # as in a container, or of another user: it does not see the claim
        monkeypatch.setenv('TMPDIR', str(tmp_path))
    second = bringup('--detector', 'cdt')
    code, out, err = second.finish()
    assert (code, out, len(err.splitlines())) == (2, '', 1)
    assert f'ROS domain {own_domain()}' in err
    names = ('/bringup', '/evaluator', '/tracker', '/cdt_detector', '/sensor')
    assert any(name in err for name in names) is not claimed
    assert not second.results.exists()
    running.wait_for_rows(len(running.rows()) + 20)
    assert running.nodes() == before


def test_nodes_end_when_bringup_is_killed(running):
    assert len(running.nodes()) == 4
    running.process.kill()
    running.wait_until_none_is_left()


def lifecycle(client, node, transition):
    """Ask a node for a transition as ``ros2 lifecycle set`` does; return whether it was made."""
    request = ChangeState.Request(transition=Transition(id=transition))
    return client.call(ChangeState, f'{node}/change_state', request).success


def shut_down(run, name):
    """Ask a node for its shutdown and wait until its process is gone."""
    request = ChangeState.Request(
        transition=Transition(id=Transition.TRANSITION_ACTIVE_SHUTDOWN))
    with GraphClient(own_domain(), topics=()) as client:
        service = client.node.create_client(ChangeState, f'/{name}/change_state')
        client.wait(service.service_is_ready)
        for _ in range(12):  # a request is lost where the node has not discovered the client yet
            service.call_async(request)
            if client.comes(lambda: f'{name}_node' not in run.nodes(), 5.0):
                return
    raise AssertionError(f'{name} did not end')


@pytest.mark.parametrize('respawn', ['--respawn', '--no-respawn'])
def test_a_node_that_is_shut_down_ends_and_is_not_started_again(bringup, respawn):
    run = bringup('--detector', 'cdt', '--loop', respawn, '--rate', '50')
    run.wait_for_rows(2 * FRAMES_BEFORE)
    tracker = run.nodes()['tracker_node']
    shut_down(run, 'tracker')
    code, _, err = run.finish()
    assert code == 1
    assert not Path(f'/proc/{tracker}').exists()
    report, = [line for line in err.splitlines() if 'tracker was ' in line]
    assert 'lifecycle' in report
    assert run.restarts() == []
    run.wait_until_none_is_left()
    assert len(run.rows()) >= 2 * FRAMES_BEFORE


def test_a_viewer_that_is_shut_down_leaves_the_run_alone(bringup):
    run = bringup('--detector', 'cdt', '--loop', '--view', '--rate', '50')
    run.wait_for_rows(2 * FRAMES_BEFORE)
    shut_down(run, 'viewer')
    run.wait_for_rows(len(run.rows()) + 2 * FRAMES_BEFORE)
    run.process.send_signal(signal.SIGINT)
    code, _, err = run.finish()
    assert code == 130
    assert run.restarts() == []
    assert any('viewer was ' in line and 'lifecycle' in line for line in err.splitlines())


def test_a_node_that_an_operator_deactivates_is_named(bringup):
    run = bringup('--detector', 'cdt', '--loop', '--rate', '50')
    run.wait_for_rows(2 * FRAMES_BEFORE)
    with GraphClient(own_domain(), topics=()) as client:
        for transition, state in (
                (Transition.TRANSITION_DEACTIVATE, 'inactive'),
                (Transition.TRANSITION_ACTIVATE, 'active')):
            assert lifecycle(client, '/tracker', transition)
            client.wait(lambda state=state: client.counts('/tracker').get('state') == state)
    answered = len(run.rows())
    run.wait_for_rows(answered + 4 * FRAMES_BEFORE)
    run.process.send_signal(signal.SIGINT)
    code, _, err = run.finish()
    assert code == 130
    said = [line for line in err.splitlines() if line.startswith('bringup.py: tracker is ')]
    assert [line.split()[3].strip(',') for line in said] == ['inactive', 'active']
    assert not [line for line in err.splitlines() if 'evaluator is ' in line]


def test_run_outlives_the_process_that_forks_its_nodes(bringup):
    run = bringup('--detector', 'cdt', '--loop', '--lockstep')
    run.wait_for_rows(2 * FRAMES_BEFORE)
    server, = (child for child in psutil.Process(run.process.pid).children()
               if 'lowsnr_bringup.run.node_server' in child.cmdline())
    server.kill()
    run.wait_for_rows(len(run.rows()) + 2 * FRAMES_BEFORE)
    run.kill('tracker_node')
    run.wait_for_restarts(1)
    run.wait_for_rows(len(run.rows()) + 2 * FRAMES_BEFORE)
    run.process.send_signal(signal.SIGINT)
    assert run.finish()[0] == 130
    run.wait_until_none_is_left()
