# SPDX-License-Identifier: Apache-2.0
"""A run on a live camera, which is a process of its own that stops and starts."""

import os
import signal
import subprocess
import sys

from graph_runs import graph_environment
from graph_runs import own_domain
from graph_runs import ROOT
from graph_runs import run_bringup
from lowsnr_bringup.bags.reader import Bag
from lowsnr_common.ros.messages import stamp_key
import psutil
import pytest

TOPIC = '/camera/image_raw'
RUN = ('--camera', TOPIC, '--detector', 'cdt', '--set', 'cdt.operating_point=manual',
       '--set', 'cdt.threshold=3.0', '--snr', '12', '--camera-within', '60')


@pytest.fixture
def camera():
    """Return a function that starts a camera; the test's end stops those that still run."""
    started = []
    sources = [str(ROOT / 'src' / name) for name in ('lowsnr_common', 'lowsnr_sensor')]
    environment = graph_environment(own_domain()) | {
        'PYTHONPATH': os.pathsep.join([*sources, os.environ.get('PYTHONPATH', '')])}

    def start():
        parameters = {
            'scenario': ROOT / 'config' / 'scenarios' / 'example3.yaml', 'loop': 'true',
            'rate_hz': 50.0, 'sensor.snr_db': 15.0}
        options = [part for name, value in parameters.items()
                   for part in ('-p', f'{name}:={value}')]
        started.append(subprocess.Popen(
            [sys.executable, '-m', 'lowsnr_sensor.sensor_node', '--ros-args', *options,
             '-r', f'image_raw:={TOPIC}', '-r', '__ns:=/camera'],
            env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()


def end(process):
    """Stop a camera without notice."""
    process.kill()
    process.wait()


def receiving(pid):
    """Return the addresses at which a process receives from other nodes."""
    first = 7400 + 250 * own_domain()  # of the ports of a domain
    bound = [item.laddr for item in psutil.Process(pid).net_connections('udp4')]
    return {address.ip for address in bound if first <= address.port < first + 250}


def interrupted(run):
    """End a run by Ctrl-C; return what it printed, its account checked."""
    run.process.send_signal(signal.SIGINT)
    code, out, err = run.finish()
    assert code == 130, err
    assert 'Traceback' not in err
    for log in (run.results / 'log').iterdir():
        assert 'Traceback' not in log.read_text(), log
    summary = run.summary()
    assert summary['scenario'] == 'camera/image_raw'
    frames = summary['frames']
    assert frames['unseen'] == 0
    assert frames['published'] == frames['scored'] + frames['unanswered'] >= 60
    assert len(run.rows()) == 2 * frames['published']
    run.wait_until_none_is_left()
    return out, err


def test_run_outlives_the_camera_and_a_detector(bringup, camera, tmp_path):
    bag = tmp_path / 'bag'
    first = camera()
    run = bringup(*RUN, '--record', str(bag))
    run.wait_for_rows(2 * 30)
    answered = {round(1e9 * float(row.split(',')[1])) for row in run.rows()}
    # What a reader missed of the last moments of a camera, it cannot send again once it is killed.
    run.wait_for_rows(len(run.rows()) + 2 * 30)
    end(first)
    camera()  # its stamps begin again, and the recorder may discover it later than others do
    run.wait_for_rows(len(run.rows()) + 2 * 30)
    run.kill('detector_node')
    run.wait_for_restarts(1)
    run.wait_for_rows(len(run.rows()) + 2 * 30)
    out, _ = interrupted(run)
    assert [row['node'] for row in run.restarts()] == ['cdt_detector']
    assert str(bag) in out
    assert run.summary()['detectors']['cdt']['detection']['declared'] > 0
    check_that_all_that_was_answered_is_recorded(bag, answered)


def check_that_all_that_was_answered_is_recorded(bag, answered):
    """Check that each of these frames is in a bag, with what the nodes made of it."""
    with Bag(bag) as recorded:
        stamps = {name: {stamp_key(recorded.read(message).header.stamp)
                         for message in recorded.messages({name})}
                  for name in (TOPIC, '/conditioned/image_raw', '/detections')}
    assert len(answered) >= 30
    missing = {name: answered - found for name, found in stamps.items()}
    assert not any(missing.values()), missing


def test_detector_comes_back_while_the_camera_is_away(bringup, camera):
    first = camera()
    run = bringup(*RUN, '--condition', 'off', '--view')
    run.wait_for_rows(2 * 30)
    assert receiving(run.process.pid) == {'127.0.0.1'}
    end(first)
    run.kill('detector_node')
    run.wait_for_restarts(1)
    camera()
    run.wait_for_rows(len(run.rows()) + 2 * 30)
    interrupted(run)
    assert [row['node'] for row in run.restarts()] == ['cdt_detector']
    tracking = run.summary()['detectors']['cdt']['tracking']
    assert tracking['pd'] is None
    assert tracking['frames_without_truth'] > 0
    assert (run.results / 'report.html').stat().st_size > 0


def test_camera_that_is_not_there_ends_with_one_line(tmp_path):
    done = run_bringup('--camera', TOPIC, '--camera-within', '0.5', '--results',
                       str(tmp_path / 'run'))
    assert (done.returncode, done.stdout) == (2, '')
    assert TOPIC in done.stderr
    assert f'ROS domain {own_domain()}' in done.stderr
    assert done.stderr.count('\n') == 1
    assert not (tmp_path / 'run').exists()
