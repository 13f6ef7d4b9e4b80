# SPDX-License-Identifier: Apache-2.0
"""Conditioner, detectors and trackers in one process: the results of several, and their return."""

import signal

from graph_runs import own_domain
from graph_runs import start_bringup
import numpy as np
import pytest

SEPARATE = {'conditioner_node', 'detector_node', 'tracker_node'}
FRAMES, SHAPE = 60, (48, 64)


@pytest.fixture
def camera_frames(tmp_path):
    """Return a file of frames of a camera that moves over a scene, and one object in them."""
    rng = np.random.default_rng(5)
    scene = np.kron(rng.normal(100.0, 20.0, (20, 20)), np.ones((6, 6)))
    frames = []
    for k in range(FRAMES):
        row, col = 10 + k // 8, 10 + k // 5
        frame = scene[row:row + SHAPE[0], col:col + SHAPE[1]] + rng.normal(0.0, 3.0, SHAPE)
        frame[20:22, 8 + k // 2:10 + k // 2] += 40.0
        frames.append(frame)
    path = tmp_path / 'frames.npz'
    np.savez(path, frames=np.array(frames, np.float32))
    return path


def finished(results, *arguments):
    """Run a graph to its end; return its run and the modules of its processes at frame one."""
    with start_bringup(results, *arguments, '--lockstep', domain_id=own_domain()) as run:
        run.wait_for_rows(1)
        modules = set(run.nodes())
        code, _, err = run.finish()
        run.wait_until_none_is_left()
    assert code == 0, err
    return run, modules


@pytest.mark.parametrize('of_camera', [False, True])
def test_composed_chains_give_the_same_rows(tmp_path, camera_frames, of_camera):
    frames = (('--replay', str(camera_frames), '--set', 'all.seed=3') if of_camera
              else ('--scenario', 'example3', '--snr', '9', '--seed', '3'))
    chosen = (*frames, '--detector', 'cdt', 'sdt')
    apart, separate = finished(tmp_path / 'apart', *chosen)
    composed, together = finished(tmp_path / 'composed', *chosen, '--composed')
    assert separate & SEPARATE == SEPARATE - ({'conditioner_node'} if not of_camera else set())
    assert together & SEPARATE == set()
    assert 'chain_node' in together
    assert composed.rows() == apart.rows()
    assert any(int(row.split(',')[5]) for row in apart.rows())  # not all of them empty
    for name in ('detections.csv', 'tracks.csv'):
        if (apart.results / name).is_file():
            assert (composed.results / name).read_bytes() == (apart.results / name).read_bytes()


@pytest.mark.parametrize('number', [signal.SIGKILL, signal.SIGTERM])
def test_all_nodes_of_a_composed_process_come_back(tmp_path, number):
    with start_bringup(
            tmp_path / 'run', '--detector', 'cdt', 'sdt', '--scenario', 'example3', '--snr', '12',
            '--loop', '--lockstep', '--composed', domain_id=own_domain()) as run:
        run.wait_for_rows(40)
        first = run.nodes()['chain_node']
        run.kill('chain_node', number)
        run.wait_for_restarts(4)
        run.wait_for_rows(len(run.rows()) + 80)
        assert run.nodes()['chain_node'] != first
        assert [module for module, _ in run.processes()].count('chain_node') == 1
        run.process.send_signal(signal.SIGINT)
        code, _, err = run.finish()
    assert code == 130
    assert sorted(row['node'] for row in run.restarts()) == [
        'cdt.cdt_detector', 'cdt.tracker', 'sdt.sdt_detector', 'sdt.tracker']
    frames = run.summary()['frames']
    assert frames['published'] == frames['scored'] + frames['unanswered'] + frames['unseen']
    assert frames['unanswered'] + frames['unseen'] <= 2, err


def test_composed_process_that_hangs_is_killed_and_all_its_nodes_come_back(tmp_path):
    with start_bringup(
            tmp_path / 'run', '--detector', 'cdt', '--scenario', 'example3', '--loop',
            '--lockstep', '--composed', '--set', 'evaluator.answer_within_s=5',
            domain_id=own_domain()) as run:
        run.wait_for_rows(20)
        run.kill('chain_node', signal.SIGSTOP)
        run.wait_for_restarts(2)
        run.wait_for_rows(len(run.rows()) + 20)
        run.process.send_signal(signal.SIGINT)
        code, _, err = run.finish()
    assert code == 130
    assert {row['node'] for row in run.restarts()} == {'cdt_detector', 'tracker'}
    assert all('stood still' in row['death'] for row in run.restarts()), err
