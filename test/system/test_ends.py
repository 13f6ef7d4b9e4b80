# SPDX-License-Identifier: Apache-2.0
"""How a run ends: in every way its frames are accounted for, and 0 means that none is missing."""

import errno
import os
import signal
import subprocess
import sys
import time

from graph_runs import own_domain
from graph_runs import ROOT
from graph_runs import run_bringup
from graph_runs import start_bringup
import numpy as np
import psutil
import pytest
from run_checks import check_cut_off
from run_checks import check_lost_at_death

FRAMES = 5000
RUN = ('--detector', 'cdt', '--frames', str(FRAMES), '--lockstep')


def check_account(run):
    """Check that the counts of the summary add up, and that the table holds what they say."""
    frames = run.summary()['frames']
    table = frames['scored'] + frames['unanswered']
    assert frames['published'] == table + frames['unseen'] + frames['lost']
    assert min(frames.values()) >= 0
    assert len(run.rows()) == 2 * table
    assert [int(row.split(',')[0]) for row in run.rows()[::2]] == list(range(1, table + 1))
    assert frames['expected'] == FRAMES
    return frames


def send_twice(run, number):
    """Send a signal, and once more while the first one is acted on."""
    run.process.send_signal(number)
    time.sleep(0.05)
    run.process.send_signal(number)


ASKED = {
    'SIGHUP': lambda run: run.process.send_signal(signal.SIGHUP),
    'SIGTERM': lambda run: run.process.send_signal(signal.SIGTERM),
    'Ctrl-C twice': lambda run: send_twice(run, signal.SIGINT),
}


@pytest.mark.parametrize('how', ASKED)
def test_a_run_that_is_asked_to_end_keeps_its_scores(bringup, how):
    run = bringup(*RUN)
    run.wait_for_rows(2 * int(np.random.default_rng(len(how)).integers(5, 200)))
    rows = len(run.rows())
    ASKED[how](run)
    code, out, err = run.finish()
    assert code == 130, err
    assert 'Traceback' not in out + err
    run.wait_until_none_is_left()
    frames = check_account(run)
    assert 2 * frames['scored'] >= rows
    check_cut_off(run)
    assert f'{frames["published"]} of {FRAMES} frames' in err
    assert (run.results / 'report.html').is_file() == (how != 'Ctrl-C twice')


def test_a_run_outlives_its_terminal(tmp_path):
    ours, theirs = os.openpty()
    with start_bringup(
            tmp_path / 'run', *RUN, domain_id=own_domain(), start_new_session=True, umask=0,
            stdin=theirs, stdout=theirs, stderr=theirs) as run:
        os.close(theirs)
        run.wait_for_rows(40)
        os.close(ours)  # no terminal is left to write to
        run.process.send_signal(signal.SIGHUP)
        assert run.process.wait(120.0) == 130
        check_account(run)
        run.wait_until_none_is_left()
    # Nobody else may change what the run has written, although its umask was 0.
    assert not [path for path in (run.results, *run.results.rglob('*'))
                if path.stat().st_mode & 0o022]


def test_a_source_that_ends_early_is_a_failure(bringup):
    run = bringup(*RUN)
    run.wait_for_rows(40)
    run.kill('sensor_node', signal.SIGINT)
    code, _, err = run.finish()
    assert code == 1
    frames = check_account(run)
    assert 20 <= frames['published'] < FRAMES
    assert f'{frames["published"]} of {FRAMES} frames' in err
    assert [line for line in err.splitlines() if 'sensor' in line and 'SIGINT' in line]


def test_a_source_that_ends_early_is_started_again(bringup):
    frames = 300
    run = bringup('--detector', 'cdt', '--frames', str(frames), '--rate', '100', '--respawn')
    run.wait_for_rows(40)
    run.kill('sensor_node', signal.SIGINT)
    code, _, err = run.finish()
    assert [row['node'] for row in run.restarts()] == ['sensor']
    counts = run.summary()['frames']
    assert (code, counts['published']) == (int(counts['unseen'] > 0), frames), err
    assert counts['published'] == counts['scored'] + counts['unanswered'] + counts['unseen']
    check_lost_at_death(run)


def test_what_a_full_disk_does_not_take_is_counted_and_fails_the_run(bringup, small_disk):
    frames = 1500
    (small_disk / 'ballast').write_bytes(bytes(900_000))
    run = bringup(
        '--detector', 'cdt', '--frames', str(frames), '--lockstep', results='disk/run')
    code, out, err = run.finish()
    assert code == 1, err
    counts = run.summary()['frames']
    assert counts['published'] == counts['expected'] == frames
    assert counts['published'] == (
        counts['scored'] + counts['unanswered'] + counts['unseen'] + counts['lost'])
    assert counts['lost'] > 0
    assert len(run.rows()) // 2 == counts['scored'] + counts['unanswered']
    assert f'{counts["lost"]} lost' in out
    assert f'{run.results}/frames.csv: {os.strerror(errno.ENOSPC)}' in err
    # The scores have the room of the animation, of the wall times and of the report.
    assert [(run.results / name).stat().st_size for name in (
        'frames.f32', 'scene.jsonl', 'latency.csv')] == [0, 0, 0]
    assert not (run.results / 'report.html').exists()
    assert (run.results / 'frames.csv').stat().st_size > 0.8 * (2**20 - 900_000)


def test_a_stopped_node_is_named_and_ends_once_it_runs_again(bringup):
    run = bringup(*RUN)
    run.wait_for_rows(40)
    tracker = psutil.Process(run.nodes()['tracker_node'])
    tracker.suspend()
    run.process.kill()
    while len(run.nodes()) > 1:
        time.sleep(0.02)
    refused = run_bringup('--detector', 'cdt', '--results', str(run.results.with_name('other')))
    assert (refused.returncode, refused.stdout) == (2, '')
    line, = refused.stderr.splitlines()
    assert f'tracker_node (process {tracker.pid})' in line
    assert f'ROS domain {own_domain()}' in line
    tracker.resume()
    run.wait_until_none_is_left()
    done = subprocess.run(
        [sys.executable, 'scripts/evaluate.py', str(run.results)], cwd=ROOT, text=True,
        capture_output=True, timeout=120.0, check=False)
    assert done.returncode == 1
    assert f'{check_account(run)["published"]} of {FRAMES} frames' in done.stderr
