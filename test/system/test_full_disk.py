# SPDX-License-Identifier: Apache-2.0
"""A full disk, and folders that are removed in a run: the run goes on, and no score is lost."""

import errno
import os
from pathlib import Path
import shutil
import signal
import time

from diagnostic_msgs.msg import DiagnosticStatus
from disk import fill
from lowsnr_bringup.bags.bag_files import METADATA_FILE
from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.recording import summarize_recording
from lowsnr_bringup.recorder_node import FAILED
from lowsnr_bringup.recorder_node import REMOVED
import pytest
from run_checks import check_cut_off

RUN = ('--detector', 'cdt', '--loop', '--lockstep')


def remove_results(run, instead=None):
    """Remove the results, or put a file in their place, while nobody writes there."""
    evaluator = run.nodes()['evaluator_node']
    os.kill(evaluator, signal.SIGSTOP)
    shutil.rmtree(run.results)
    if instead is not None:
        run.results.write_text(instead)
    os.kill(evaluator, signal.SIGCONT)


def stop(run):
    """End a run by Ctrl-C; return exit code, stdout and stderr."""
    run.process.send_signal(signal.SIGINT)
    return run.finish()


def wait_for(text, path, within_s=120.0):
    """Wait until a log holds a text."""
    until = time.monotonic() + within_s
    while text not in path.read_text():
        assert time.monotonic() < until, path.read_text()
        time.sleep(0.05)


def wait_for_bag(run, folder):
    """Wait until metadata and frames of a bag are on the disk."""
    while not (folder / METADATA_FILE).exists() or sum(
            path.stat().st_size for path in folder.glob('*.mcap')) < 400_000:
        run.wait_for_rows(len(run.rows()) + 2)


def check_whole(run):
    """Check that the table has every frame that was published, and none twice."""
    frames = run.summary()['frames']
    check_cut_off(run)
    timed = (run.results / 'latency.csv').read_text().count('\n') - 1
    assert frames['scored'] <= timed <= frames['scored'] + frames['unanswered']


def test_scores_wait_for_room_on_a_full_disk(bringup, small_disk, client):
    run = bringup(*RUN, results='disk/run')
    run.wait_for_rows(40)
    fill(small_disk / 'ballast')
    client.wait(lambda: client.level('/evaluator') == DiagnosticStatus.ERROR)
    assert client.statuses('/evaluator', str(small_disk))
    (small_disk / 'ballast').unlink()
    rows = len(run.rows())
    run.wait_for_rows(rows + 200)
    assert stop(run)[0] == 130
    check_whole(run)
    run.wait_until_none_is_left()


@pytest.mark.parametrize('restart', [False, True], ids=['', 'and the evaluator killed'])
def test_results_folder_that_is_removed_comes_back(bringup, restart):
    run = bringup(*RUN)
    run.wait_for_rows(100)
    remove_results(run)
    until = time.monotonic() + 120.0
    while not (run.results / 'frames.csv').exists():
        assert time.monotonic() < until
        time.sleep(0.05)
    if restart:
        run.kill('evaluator_node')
        run.wait_for_restarts(1)
    run.wait_for_rows(len(run.rows()) + 100)
    code, _, err = stop(run)
    assert code == 130
    assert 'Traceback' not in err
    if not restart:
        check_whole(run)
    assert int(run.rows()[0].split(',')[0]) == 1
    run.wait_until_none_is_left()


def test_node_that_cannot_be_started_is_tried_again(bringup):
    run = bringup(*RUN)
    run.wait_for_rows(20)
    remove_results(run, instead='in the way')
    detector = Path('/proc', str(run.nodes()['detector_node']))
    run.kill('detector_node')
    while detector.exists():  # until bring-up knows
        time.sleep(0.02)
    time.sleep(3.0)
    run.results.unlink()
    run.wait_for_restarts(1)
    run.wait_for_rows(len(run.rows()) + 20)
    code, _, err = stop(run)
    assert code == 130
    named = [line for line in err.splitlines() if 'cdt_detector' in line]
    assert [line for line in named if os.strerror(errno.ENOTDIR) in line
            or os.strerror(errno.EEXIST) in line], named
    assert 'Traceback' not in err


def test_recorder_on_a_full_disk_does_not_end_the_run(bringup, small_disk):
    run = bringup(*RUN, '--record', str(small_disk / 'bag'))
    wait_for_bag(run, small_disk / 'bag')
    fill(small_disk / 'ballast')
    wait_for(f'{small_disk / "bag"}: ', run.results / 'log' / 'recorder.log')
    run.wait_for_rows(len(run.rows()) + 400)
    code, _, err = stop(run)
    assert code == 130
    assert f'recorder ended with status {FAILED}' in err
    assert not summarize_recording(small_disk / 'bag').finished
    with Bag(small_disk / 'bag') as bag:
        assert sum(1 for _ in bag.messages({'/image_raw'})) > 20
    run.wait_until_none_is_left()


def test_a_killed_recorder_goes_on_in_a_bag_of_its_own(bringup, tmp_path):
    run = bringup(*RUN, '--record', str(tmp_path / 'bag'))
    wait_for_bag(run, tmp_path / 'bag')
    run.kill('recorder_node')
    run.wait_for_restarts(1)
    run.wait_for_rows(len(run.rows()) + 200)
    code, out, _ = stop(run)
    assert code == 130
    stamps = []
    for name in ('bag', 'bag-2'):
        assert str(tmp_path / name) in out
        with Bag(tmp_path / name) as bag:
            stamps.append([message.logged_ns for message in bag.messages({'/image_raw'})])
    assert stamps[0]
    assert len(stamps[1]) > 50
    assert stamps[0][-1] < stamps[1][0]


def test_bag_that_is_removed_is_followed_by_another(bringup, tmp_path):
    run = bringup(*RUN, '--record', str(tmp_path / 'bag'))
    run.wait_for_rows(100)
    shutil.rmtree(tmp_path / 'bag')
    run.wait_for_restarts(1)
    run.wait_for_rows(len(run.rows()) + 200)
    code, _, err = stop(run)
    assert code == 130
    assert f'recorder ended with status {REMOVED}' in err
    assert not summarize_recording(tmp_path / 'bag').exists
    assert summarize_recording(tmp_path / 'bag-2').finished
    with Bag(tmp_path / 'bag-2') as bag:
        assert sum(1 for _ in bag.messages({'/image_raw'})) > 50
