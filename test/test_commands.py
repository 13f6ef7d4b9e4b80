# SPDX-License-Identifier: Apache-2.0
"""The test command's own exit codes and options, and what a test does without its program."""

import os
from pathlib import Path
import signal
import subprocess
import sys
import time

import browser
import pytest

ROOT = Path(__file__).resolve().parents[1]
COMMAND = ROOT / 'scripts' / 'test.py'
# The command with other linters than its own, which check the repository, not the file given.
WITH_LINTERS = f"""
import runpy, sys
sys.path.insert(0, {str(COMMAND.parent)!r})
command = runpy.run_path({str(COMMAND)!r})
command['LINTERS'].clear()
command['LINTERS'].update(%s)
sys.exit(command['main']())
"""
ONE_SLOW = """
import pytest
def test_fast(): pass
@pytest.mark.slow
def test_slow(): raise AssertionError
"""
# A test that waits for a process, which a fixture ends; both leave their process id in a file.
ENDLESS = """
import os, pathlib, subprocess, time
import pytest

@pytest.fixture
def process():
    with subprocess.Popen(['sleep', '300']) as started:
        path = pathlib.Path(__file__)
        path.with_suffix('.new').write_text(f'{os.getpid()} {started.pid}')
        path.with_suffix('.new').rename(path.with_suffix('.pids'))
        try:
            yield started
        finally:
            started.kill()

def test_endless(process):
    process.wait()
"""


def start(*arguments, linters=None, **environ):
    """Start the command with these linters."""
    return subprocess.Popen(
        [sys.executable, '-c', WITH_LINTERS % (linters or {}), *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ | environ)


def run(*arguments, linters=None, **environ):
    """Run the command to its end; return its exit code, its last line and its complaint."""
    with start(*arguments, linters=linters, **environ) as process:
        out, err = process.communicate(timeout=300.0)
    return process.returncode, (out.splitlines() or [''])[-1], err


@pytest.mark.parametrize('workers', [2, pytest.param(0, marks=pytest.mark.slow)])
@pytest.mark.parametrize(('body', 'code', 'verdict'), [
    ('pass', 0, 'passed'),
    ('raise AssertionError', 1, 'FAILED: pytest'),
    ('raise KeyboardInterrupt', 130, 'interrupted'),
])
def test_exit_code_says_how_the_tests_went(tmp_path, workers, body, code, verdict):
    path = tmp_path / 'test_one.py'
    path.write_text(f'def test_one():\n    {body}\n')
    found, last, _ = run(f'-n{workers}', path)
    assert found == code
    assert verdict in last


def test_linter_that_finds_something_is_named_and_a_failure(tmp_path):
    path = tmp_path / 'test_one.py'
    path.write_text('def test_one(): pass\n')
    (tmp_path / 'bad.py').write_text('1 +\n')
    linters = {'bad': ['py_compile', str(tmp_path / 'bad.py')],
               'good': ['py_compile', str(path)]}
    code, last, _ = run('-n0', path, linters=linters)
    assert code == 1
    assert 'bad' in last
    assert 'good' not in last


def test_file_that_cannot_be_imported_is_a_failure(tmp_path):
    (tmp_path / 'test_broken.py').write_text('import no_such_module\n')
    assert run('-n2', tmp_path / 'test_broken.py')[0] == 1


def test_no_test_at_all_is_a_failure(tmp_path):
    (tmp_path / 'test_none.py').touch()
    assert run('-n0', tmp_path / 'test_none.py')[0] == 1


def test_unknown_option_is_a_usage_error():
    code, _, err = run('--no-such-option')
    assert code == 2
    assert '--no-such-option' in err


@pytest.mark.parametrize(('options', 'code'), [([], 0), (['--slow'], 1)])
def test_slow_tests_run_on_request(tmp_path, options, code):
    (tmp_path / 'test_one.py').write_text(ONE_SLOW)
    assert run('-n0', *options, tmp_path, COVERAGE_FILE=str(tmp_path / 'coverage'))[0] == code


@pytest.mark.slow
def test_coverage_has_a_line_for_each_package(tmp_path):
    (tmp_path / 'test_one.py').write_text(
        'def test_one():\n    from lowsnr_common.core import motion\n')
    with start('-n2', '--coverage', tmp_path, COVERAGE_FILE=str(tmp_path / 'coverage')) as process:
        out, _ = process.communicate(timeout=300.0)
    shares = {words[0]: float(words[1]) for words in map(str.split, out.splitlines())
              if words[2:] == ['%']}
    assert sorted(shares) == [
        'lowsnr', 'lowsnr_bringup', 'lowsnr_common', 'lowsnr_detect', 'lowsnr_eval',
        'lowsnr_sensor', 'lowsnr_track', 'total']
    assert 0.0 < shares['total'] < shares['lowsnr_common'] < 100.0
    assert process.returncode == 0


def wait_for_pids(folder, count):
    """Wait until this many files hold process ids; return the ids."""
    until = time.monotonic() + 120.0
    while len(found := list(folder.glob('*.pids'))) < count:
        assert time.monotonic() < until, found
        time.sleep(0.05)
    return {int(pid) for path in found for pid in path.read_text().split()}


def is_running(pid):
    """Return whether a process runs; one that was killed may still wait for its parent."""
    try:
        return Path('/proc', str(pid), 'stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except OSError:
        return False


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize('workers', [0, 2])
def test_interrupt_ends_tests_linters_and_what_they_started(tmp_path, workers, number):
    for worker in range(max(1, workers)):  # a worker takes the tests of a whole file
        (tmp_path / f'test_endless_{worker}.py').write_text(ENDLESS)
    (tmp_path / 'endless_linter.py').write_text(
        'import os, pathlib, subprocess\n'
        'started = subprocess.Popen(["sleep", "300"])\n'
        f'pathlib.Path({str(tmp_path / "linter.new")!r}).write_text(\n'
        '    f"{os.getpid()} {started.pid}")\n'
        f'os.rename({str(tmp_path / "linter.new")!r}, {str(tmp_path / "linter.pids")!r})\n'
        'started.wait()\n')
    path = os.pathsep.join([str(tmp_path), *sys.path])
    with start(f'-n{workers}', *tmp_path.glob('test_*.py'), PYTHONPATH=path,
               linters={'endless': ['endless_linter']}) as process:
        try:
            pids = wait_for_pids(tmp_path, 1 + max(1, workers))
            process.send_signal(number)
            process.communicate(timeout=120.0)
        finally:
            process.kill()
    assert process.returncode == 130
    until_s = time.monotonic() + 60.0  # what was killed takes its time to go
    while (left := [pid for pid in pids if is_running(pid)]) and time.monotonic() < until_s:
        time.sleep(0.1)
    assert not left


def test_help_shows_an_example():
    done = subprocess.run(
        [sys.executable, str(COMMAND), '--help'], capture_output=True, text=True, check=True)
    assert 'example: python scripts/test.py' in done.stdout
    assert '--slow' in done.stdout


def test_missing_program_skips_on_a_users_machine(monkeypatch, require_program):
    monkeypatch.delenv('CI', raising=False)
    with pytest.raises(pytest.skip.Exception, match='no-such-program'):
        require_program('no-such-program')


def test_missing_program_fails_in_ci(monkeypatch, require_program):
    monkeypatch.setenv('CI', 'true')
    with pytest.raises(pytest.fail.Exception, match='no-such-program'):
        require_program('no-such-program')


def test_browser_is_found_by_any_of_its_names_where_it_runs(monkeypatch, tmp_path):
    monkeypatch.setenv('PATH', f'{tmp_path}:/bin:/usr/bin')
    monkeypatch.setattr(browser, '_NAMES', ('chromium-of-snap', 'google-chrome-of-test'))
    monkeypatch.delenv('BROWSER', raising=False)
    assert browser.find_browser() is None
    for name, text in {'chromium-of-snap': 'exit 10', 'google-chrome-of-test': 'echo Chrome 1',
                       'mychrome': 'echo Chromium 2'}.items():
        (tmp_path / name).write_text(f'#!/bin/sh\n{text}\n')
        (tmp_path / name).chmod(0o755)
    assert browser.find_browser() == str(tmp_path / 'google-chrome-of-test')
    monkeypatch.setenv('BROWSER', str(tmp_path / 'mychrome'))
    assert browser.find_browser() == str(tmp_path / 'mychrome')


def test_program_on_the_path_is_found(require_program):
    assert Path(require_program('sh')).name == 'sh'
