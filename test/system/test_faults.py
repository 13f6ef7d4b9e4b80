"""Nodes that die, Ctrl-C, and a bring-up that is gone: nothing is left, nothing is lost."""

import os
import signal
import time

import pytest

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
    assert f'{label} was killed by SIGKILL' in err
    assert f'{label}.log' in err
    assert 'Traceback' not in err
    run.wait_until_none_is_left()
    assert len(run.rows()) >= 2 * FRAMES_BEFORE


def test_ctrl_c_ends_a_run_as_soon_as_it_started_and_keeps_the_scores(bringup):
    ends_s, starts_s = zip(*(start_and_end(bringup, f'run {n}') for n in range(3)), strict=True)
    assert min(ends_s) < min(starts_s)  # what else the machine does only adds


def start_and_end(bringup, results):
    """Start a run and end it by Ctrl-C; return how long its end and its start took [s]."""
    start = time.monotonic()
    run = bringup('--detector', 'sdt', '--loop', '--lockstep', results=results)
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
    assert frames['scored'] == len(run.rows()) // 2
    return ended - started, started - start


def test_second_run_on_the_same_domain_is_refused(bringup):
    first = bringup('--detector', 'cdt', '--loop', '--rate', '50')
    first.wait_for_rows(2)
    second = bringup('--detector', 'cdt', results='second')
    code, out, err = second.finish()
    assert (code, out, len(err.splitlines())) == (2, '', 1)
    assert 'another run uses ROS domain' in err
    assert not second.results.exists()
    first.process.send_signal(signal.SIGINT)
    assert first.finish()[0] == 130


def test_nodes_end_when_bringup_is_killed(bringup):
    run = bringup('--detector', 'cdt', '--loop', '--rate', '50')
    run.wait_for_rows(2 * FRAMES_BEFORE)
    assert len(run.nodes()) == 4
    run.process.kill()
    run.wait_until_none_is_left(within_s=60.0)
