# SPDX-License-Identifier: Apache-2.0
"""Local workers: results, deaths and errors of tasks."""

import math
import os
from pathlib import Path
import signal
import subprocess
import sys

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_common.core.records import Malformed
from lowsnr_eval.study.workers import LocalWorkers
from lowsnr_eval.study.workers import WorkerDiedError
from lowsnr_eval.study.workers import workers
import pytest
from worker_tasks import die_once
from worker_tasks import die_while_sending
from worker_tasks import fail
from worker_tasks import surroundings

TASKS = {str(n): (float(n),) for n in range(20)}
ROOTS = {name: math.sqrt(value) for name, (value,) in TASKS.items()}


@pytest.fixture
def log():
    return []


def results(found, function, tasks):
    kept = []
    found.run(function, tasks, lambda name, result: kept.append((name, result)))
    assert len(dict(kept)) == len(kept)
    return dict(kept)


@pytest.mark.parametrize('jobs', [1, 3])
def test_result_of_every_task_is_kept_once(log, jobs):
    with workers(jobs, None, log.append) as found:
        assert results(found, math.sqrt, TASKS) == ROOTS
        assert results(found, math.sqrt, {}) == {}
    assert log == []


def test_local_workers_have_one_thread_and_import_no_dask(log, monkeypatch):
    monkeypatch.delenv('OMP_NUM_THREADS', raising=False)
    with workers(1, None, log.append) as found:
        assert results(found, surroundings, {'a': ()}) == {'a': (False, True, '1')}
    assert 'OMP_NUM_THREADS' not in os.environ
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def test_first_process_of_a_program_receives_no_ctrl_c():
    text = ('from lowsnr_eval.study.local_pool import LocalPool\n'
            'from worker_tasks import surroundings\n'
            'with LocalPool(1) as pool:\n'
            '    print(pool.submit(surroundings).result()[1])\n')
    found = subprocess.run(
        [sys.executable, '-c', text], env=os.environ | {'PYTHONPATH': os.pathsep.join(sys.path)},
        capture_output=True, text=True, check=True)
    assert found.stdout == 'True\n'


@pytest.mark.parametrize('die', [die_once, die_while_sending])
def test_worker_that_dies_is_named_and_its_tasks_start_again(log, tmp_path, die):
    tasks = {str(n): (tmp_path / 'dead', n) for n in range(8)}
    with workers(2, None, log.append) as found:
        assert results(found, die, tasks) == {str(n): n for n in range(8)}
    line, = log
    assert (tmp_path / 'dead').read_text() in line.split()
    assert 'SIGKILL' in line


def test_task_that_always_kills_its_worker_fails(log):
    with workers(1, None, log.append) as found:
        with pytest.raises(WorkerDiedError, match='SIGKILL'):
            results(found, signal.raise_signal, {'a': (signal.SIGKILL,)})
        assert results(found, math.sqrt, TASKS) == ROOTS
    assert len(log) == LocalWorkers.restarts


@pytest.mark.parametrize('error', [
    UnusableFile(Path('a'), 'missing', 'there is none'), Malformed('size', 'of 3')])
def test_errors_of_a_task_arrive_as_they_are(log, error):
    with workers(1, None, log.append) as found, pytest.raises(type(error)) as caught:
        results(found, fail, {'a': (error,)})
    assert (str(caught.value), caught.value.reason) == (str(error), error.reason)


def test_error_of_a_task_ends_its_batch_alone(log):
    with workers(2, None, log.append) as found:
        with pytest.raises(ValueError, match='math domain'):
            results(found, math.sqrt, TASKS | {'bad': (-1.0,)})
        assert results(found, math.sqrt, TASKS) == ROOTS
    assert log == []
