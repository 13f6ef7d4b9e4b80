# SPDX-License-Identifier: Apache-2.0
"""The command that reproduces Section VI: its results, its errors, and its workers."""

from importlib.metadata import version
import json
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import time

from browser import browser
from certificates import make_certificates
from dask_cluster import dask_cluster
from lowsnr_eval.study.study_identity import code_digest
import psutil
import pytest

ROOT = Path(__file__).resolve().parents[2]
COMMAND = ROOT / 'scripts' / 'reproduce.py'
# CDT is calibrated in a moment, and at one SNR the runs are few.
SMALL = ('--example', '2', '--snr', '9', '--detector', 'cdt')
NUMBERS = ('summary.json', 'curves.csv')


def start(*arguments):
    return subprocess.Popen(
        [sys.executable, str(COMMAND), *map(str, arguments)], stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, start_new_session=True)


def run(*arguments):
    process = start(*arguments)
    out, err = process.communicate(timeout=240)
    return process.returncode, out, err


def numbers(folder):
    return [(folder / 'example2' / name).read_bytes() for name in NUMBERS]


def finished(folder):
    return sorted(path.name for path in (folder / 'example2' / 'runs').glob('*.npz'))


@pytest.fixture(scope='module')
def reference(tmp_path_factory):
    """Return the results folder of a small study on one process, and its output."""
    folder = tmp_path_factory.mktemp('reference')
    code, out, err = run(*SMALL, '--runs', '40', '--jobs', '1', '--results', folder)
    assert code == 0, err
    return folder, out, err


def test_study_leaves_summary_curves_figures_and_report(reference):
    folder, out, err = reference
    results = folder / 'example2'
    summary = json.loads((results / 'summary.json').read_text())
    assert summary['runs_done'] == 40
    assert {row['operating_point'] for row in summary['points']} == {'nominal', 'matched'}
    figures = {path.name for path in (results / 'figures').iterdir()}
    assert {'trajectory.svg', 'trajectory.png', 'paper-9dB-matched.svg', 'roc.png',
            'snr.svg', 'time.svg', 'all-9dB-nominal.png'} <= figures
    assert f'results in {results}' in out
    assert 'calibrating' in err
    assert '\r' not in err
    assert err.splitlines()[-1].startswith('example2: 90 of 90 runs')
    assert 'Traceback' not in err


def test_report_holds_all_that_it_shows(reference):
    report = (reference[0] / 'example2' / 'report.html').read_text()
    assert 'http' not in report.replace('http-equiv', '')
    assert 'scripts/reproduce.py --example 2' in report
    assert version('numpy') in report
    assert code_digest() in report
    assert 'seed 0' in report


def test_browser_shows_the_report_and_requests_nothing_else(
        reference, tmp_path, chromium):
    report = reference[0] / 'example2' / 'report.html'
    with browser(chromium, tmp_path / 'profile') as page:
        page.load(report)
        widths = page.value('Array.from(document.images).map(i => i.naturalWidth)')
        assert len(widths) >= 8
        assert min(widths) > 0
        assert page.value("document.querySelectorAll('table').length") > 3
        # Nothing sticks out of the page, however wide a table is.
        assert page.value('document.body.scrollWidth <= window.innerWidth')
        asked = [address for address in page.requests if not address.startswith('data:')]
        assert (asked, page.errors) == ([report.as_uri()], [])


@pytest.mark.slow
def test_numbers_are_the_same_whatever_the_number_of_jobs(reference, tmp_path):
    code, _, err = run(*SMALL, '--runs', '40', '--jobs', '2', '--results', tmp_path)
    assert code == 0, err
    assert numbers(tmp_path) == numbers(reference[0])


@pytest.mark.slow
def test_workers_started_by_hand_give_the_same_numbers(reference, tmp_path):
    with dask_cluster(tmp_path, 2) as (address, _):
        code, _, err = run(
            *SMALL, '--runs', '40', '--scheduler', address, '--results', tmp_path)
    assert code == 0, err
    assert numbers(tmp_path) == numbers(reference[0])


@pytest.mark.slow
def test_workers_without_the_code_are_rejected(tmp_path):
    with dask_cluster(tmp_path, 1, path='') as (address, _):
        code, _, err = run(*SMALL, '--scheduler', address, '--results', tmp_path / 'results')
    assert code == 2
    assert address in err
    assert 'PYTHONPATH' in err
    assert len(err.splitlines()) == 1


@pytest.mark.slow
def test_killed_worker_of_a_scheduler_costs_time_and_no_results(
        reference, tmp_path, require_program):
    tls = make_certificates(require_program('openssl'), tmp_path / 'tls')
    with dask_cluster(tmp_path, 3, tls) as (address, workers):
        process = start(
            *SMALL, '--runs', '40', '--scheduler', address, '--results', tmp_path, '--tls-ca',
            tls['ca'], '--tls-cert', tls['cert'], '--tls-key', tls['key'])
        wait_for_blocks(process, tmp_path)
        workers[0].kill()
        _, err = process.communicate(timeout=240)
    assert process.returncode == 0, err
    assert numbers(tmp_path) == numbers(reference[0])


@pytest.mark.slow
def test_killed_local_worker_is_named_and_costs_no_results(reference, tmp_path):
    process = start(*SMALL, '--runs', '40', '--jobs', '2', '--results', tmp_path)
    wait_for_blocks(process, tmp_path)
    worker = workers_of(process)[0]
    worker.kill()
    _, err = process.communicate(timeout=240)
    assert process.returncode == 0, err
    assert f' {worker.pid} ' in err
    assert 'SIGKILL' in err
    assert numbers(tmp_path) == numbers(reference[0])


def test_local_run_opens_no_port_and_leaves_no_process(tmp_path):
    process = start(*SMALL, '--runs', '40', '--jobs', '2', '--results', tmp_path)
    wait_for_blocks(process, tmp_path)
    main = psutil.Process(process.pid)
    processes = [main, *main.children(recursive=True)]
    assert len(workers_of(process)) == 2
    assert internet_sockets(processes) == []
    process.kill()
    process.communicate()
    _, left = psutil.wait_procs(processes, timeout=20.0)
    assert left == []


def test_open_port_is_seen():
    with socket.create_server(('127.0.0.1', 0)) as server:
        port = server.getsockname()[1]
        assert port in {found.laddr.port for found in internet_sockets([psutil.Process()])}


@pytest.mark.slow
def test_interrupted_study_keeps_its_runs_and_continues(reference, tmp_path):
    options = (*SMALL, '--runs', '40', '--jobs', '2', '--results', tmp_path)
    process = start(*options)
    wait_for_blocks(process, tmp_path)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert '--resume' in err.splitlines()[-1]
    assert 'Traceback' not in err
    kept = finished(tmp_path)
    times = [(tmp_path / 'example2' / 'runs' / name).stat().st_mtime_ns for name in kept]
    code, _, err = run(*options, '--resume')
    assert code == 0, err
    assert numbers(tmp_path) == numbers(reference[0])
    assert times == [
        (tmp_path / 'example2' / 'runs' / name).stat().st_mtime_ns for name in kept]


def workers_of(process):
    """Return the worker processes, without the resource tracker of multiprocessing."""
    return [child for child in psutil.Process(process.pid).children()
            if 'spawn_main' in ' '.join(child.cmdline())]


def internet_sockets(processes):
    return [found for process in processes for found in process.net_connections('inet')]


def wait_for_blocks(process, folder):
    """Wait until the first block of runs is finished."""
    until = time.monotonic() + 120.0
    while not finished(folder):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < until, 'no block after two minutes'
        time.sleep(0.02)
