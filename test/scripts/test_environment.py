# SPDX-License-Identifier: Apache-2.0
"""The environment: which Python a script uses, and how each fault ends it."""

import ast
from contextlib import contextmanager
from contextlib import suppress
import os
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys
import time

import _steps
import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = sorted((ROOT / 'scripts').glob('*.py'))
NO_NETWORK = {
    'PIP_CONFIG_FILE': os.devnull, 'PIP_FIND_LINKS': '', 'PIP_INDEX_URL': 'http://127.0.0.1:9/',
    'PIP_NO_CACHE_DIR': '1', 'PIP_RETRIES': '0',
}


@contextmanager
def started(checkout, **environ):
    """Start the script with a Python that has no ROS 2; end all its processes at the end."""
    dropped = {'PYTHONPATH', 'ROS_DISTRO', 'CC', 'CXX'}
    kept = {key: value for key, value in _steps.environ().items() if key not in dropped}
    process = subprocess.Popen(
        [sys._base_executable, checkout / 'scripts' / 'script.py', 'argument'], text=True,
        env=kept | environ, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        yield process
    finally:
        process.kill()
        for pid in left_of(checkout):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        process.communicate()


def left_of(checkout):
    """Return the ids of the processes that have the checkout in their command line."""
    found = []
    for path in Path('/proc').glob('[0-9]*/cmdline'):
        with suppress(FileNotFoundError, ProcessLookupError):
            if str(checkout).encode() in path.read_bytes():
                found.append(int(path.parent.name))
    return found


def run(checkout, **environ):
    """Run the script to its end; return exit code, stdout and the lines on stderr."""
    with started(checkout, **environ) as process:
        out, errors = process.communicate(timeout=60)
        return process.returncode, out, errors.splitlines()


def wait_for(process, text):
    """Read the lines on stderr up to the one with this text."""
    for line in process.stderr:
        if text in line:
            return
    raise AssertionError(f'ended without {text!r}')


def seconds(*commands):
    """Return the shortest time of five runs of each command [s], taken in turn."""
    times = [[] for _ in commands]
    for _ in range(5):
        for command, found in zip(commands, times, strict=True):
            start = time.perf_counter()
            subprocess.run(command, env=_steps.environ(), check=True)
            found.append(time.perf_counter() - start)
    return [min(found) for found in times]


def test_second_start_costs_less_than_the_imports_of_a_node():
    code = f'import sys; sys.path.insert(0, {str(ROOT / "scripts")!r}); import _environment; '
    start_s, imports_s = seconds(
        (sys._base_executable, '-c', code + '_environment.ensure()'),
        (sys.executable, '-c', 'import rclpy, rclpy.lifecycle, numpy, scipy.ndimage'))
    assert start_s < imports_s


def test_script_restarts_in_the_environment_of_the_tests():
    code = (f'import sys; sys.path.insert(0, {str(ROOT / "scripts")!r}); import _environment; '
            '_environment.ensure(dev=True); import lowsnr_sensor, vision_msgs.msg; '
            'print(sys.prefix, sys.argv)')
    nothing_else = {'PATH': '', **NO_NETWORK}
    done = subprocess.run([sys._base_executable, '-c', code, 'x y'], text=True, check=True,
                          env=_steps.environ() | nothing_else, capture_output=True)
    assert done.stdout == f"{sys.prefix} ['-c', 'x y']\n"
    assert done.stderr == ''


def test_complete_ros_is_used_as_it_is(checkout, ros):
    code, out, errors = run(checkout, PYTHONPATH=str(ros), PATH='')
    assert (code, errors) == (0, [])
    assert out == (f'{sys.base_prefix} {checkout / "src" / "lowsnr_any"}{os.pathsep}{ros} '
                   "['argument']\n")
    assert not (checkout / '.venv').exists()


def test_only_what_an_installed_ros_lacks_is_added(checkout, ros):
    shutil.rmtree(ros / 'tqdm-1.dist-info')
    code, _, errors = run(checkout, PYTHONPATH=str(ros), PATH='', **NO_NETWORK)
    assert code == 1
    assert [line[:5] for line in errors[1:3]] == ['[1/3]', '[2/3]']
    assert ' 1 package' in errors[2]
    settings = (checkout / '.venv' / 'pyvenv.cfg').read_text()
    assert 'include-system-site-packages = true' in settings
    assert 'tqdm==' in (checkout / '.venv' / 'requirements.txt').read_text()


@pytest.mark.parametrize(('extra', 'packages'), [
    ('bags', 'lz4 mcap rosbags zstandard'), ('images', 'opencv-python-headless')])
def test_installed_command_names_the_packages_that_it_uses_and_lacks(checkout, extra, packages):
    shutil.rmtree(checkout / 'src')  # as colcon installs it
    assert run(checkout)[0] == 0  # of what rosdep installs nothing is checked
    script = checkout / 'scripts' / 'script.py'
    script.write_text(script.read_text().replace('ensure(())', f"ensure(('{extra}',))"))
    code, _, errors = run(checkout)
    assert (code, len(errors)) == (2, 1)
    assert errors[0].endswith(f'pip install {packages}')
    assert not (checkout / '.venv').exists()


@pytest.mark.parametrize(('spoil', 'environ', 'message'), [
    ('vision_msgs', {}, 'sudo apt-get install ros-jazzy-vision-msgs'),
    ('rclpy/_rclpy*', {}, sys._base_executable),
    ('nothing', {'ROS_DISTRO': 'humble'}, 'humble'),
])
def test_unusable_ros_is_refused(checkout, ros, spoil, environ, message):
    for path in ros.glob(spoil):
        path.rename(ros / 'away')
    code, _, errors = run(checkout, PYTHONPATH=str(ros), **environ)
    assert code == 2
    assert len(errors) == 1
    assert message in errors[0]
    assert not (checkout / '.venv').exists()


def test_missing_compiler_ends_the_script_before_anything_is_made(checkout):
    code, _, errors = run(checkout, PATH='')
    assert (code, len(errors)) == (2, 1)
    assert 'sudo apt-get install g++' in errors[0]
    assert not (checkout / '.venv').exists()


def test_old_python_names_the_versions_to_install(checkout):
    code, _, errors = run(checkout, OLD_PYTHON='1', PATH='')
    assert (code, len(errors)) == (2, 1)
    assert not [version for version in ('3.9', '3.11', '3.12', '3.13') if version not in errors[0]]


def test_old_python_restarts_in_another(checkout, tmp_path):
    shim = tmp_path / 'shims' / 'python3.12'  # first on the path, but refuses
    usable = tmp_path / 'bin' / 'python{}.{}'.format(*sys.version_info)
    for path in (shim, usable):
        path.parent.mkdir()
    shim.write_text('#!/bin/sh\nexit 127\n')
    shim.chmod(0o755)
    usable.symlink_to(sys._base_executable)
    path = os.pathsep.join([str(shim.parent), str(usable.parent)])
    code, _, errors = run(checkout, OLD_PYTHON='1', PATH=path)
    assert code == 2
    assert 'Python 3.9 ' in errors[0]
    assert errors[0].endswith(f' {usable}')
    assert 'g++' in errors[1]


@pytest.mark.parametrize('script', SCRIPTS, ids=lambda path: path.name)
def test_script_leaves_an_old_python_before_it_can_fail(script):
    tree = ast.parse(script.read_text('utf-8'), feature_version=(3, 8))
    if script.stem in ('_environment', '_steps', '_venv'):  # they are in old syntax
        return
    kinds = [type(node) for node in tree.body]
    names = [getattr(node, 'module', '') or node.names[0].name
             if isinstance(node, (ast.Import, ast.ImportFrom)) else '' for node in tree.body]
    defined = [kinds.index(kind) for kind in (ast.FunctionDef, ast.ClassDef) if kind in kinds]
    leaving = {'_environment'} if script.stem == '_arguments' else {'_arguments', '_environment'}
    own = {name for name in names if re.match('_[a-z]', name)} - leaving
    others = [names.index(name) for name in own]
    left = [names.index(name) for name in leaving.intersection(names)]
    if not left:  # only those import it that have left before
        assert script.stem.startswith('_')
        return
    assert min(left) < min([*defined, *others], default=len(kinds))


def test_second_of_two_starts_waits_for_the_first(checkout):
    with started(checkout, **NO_NETWORK) as first:
        wait_for(first, '[1/6]')
        with started(checkout, **NO_NETWORK) as second:
            wait_for(second, 'waiting')
            wait_for(first, '[2/6]')
            last = first.communicate(timeout=60)[1].splitlines()[-1]
            wait_for(second, '[1/6]')
    assert first.returncode == 1
    assert 'package index' in last
    assert str(checkout / '.venv.log') in last
    assert not (checkout / '.venv' / 'complete.json').exists()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_interrupt_leaves_no_process(checkout, number):
    with started(checkout) as process:
        wait_for(process, '[1/6]')
        process.send_signal(number)
        errors = process.communicate(timeout=5)[1]
        assert process.returncode == 128 + number
        assert errors.count('\n') == 1
        assert errors.startswith('lowsnr: interrupted')
        time.sleep(0.5)  # for the system to end what was killed
        assert left_of(checkout) == []


def test_start_after_a_killed_one_begins_again(checkout):
    with started(checkout) as process:
        wait_for(process, '[1/6]')
        while len(left_of(checkout)) < 2:
            time.sleep(0.01)
        process.kill()
        process.wait()
        with started(checkout) as second:
            wait_for(second, 'waiting')  # for the step, which outlives the killed start
            wait_for(second, '[1/6]')


def test_log_that_cannot_be_written_is_named(checkout):
    (checkout / '.venv.log').mkdir()
    code, _, errors = run(checkout)
    assert code == 2
    assert len(errors) == 1
    assert str(checkout / '.venv.log') in errors[0]
