"""The environment's making: when it is complete, what a step prints, what the locks hold."""

import fcntl
import importlib.util
import json
from pathlib import Path
import re
import sys

import _steps
import _venv
import pytest
import vision_msgs

ROOT = Path(__file__).resolve().parents[2]
HASH = 'RIHS01_214274120007f4a683866481336b70310268cfa107aebe9d594a6acf75bda968'


def venv_of(checkout):
    """Return the module that is in charge of a checkout's environment."""
    path = checkout / 'scripts' / '_venv.py'
    spec = importlib.util.spec_from_file_location('venv_of_checkout', path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def completed(checkout):
    """Return a checkout whose environment claims to be complete."""
    venv = venv_of(checkout)
    venv.PYTHON.parent.mkdir(parents=True)
    venv.PYTHON.symlink_to(sys._base_executable)
    venv.STAMP.write_text(json.dumps({'key': venv._key(), 'contents': ['ros']}))
    assert venv.is_complete({'ros'})
    return checkout


def test_environment_lacks_what_it_was_not_made_with(completed):
    assert not venv_of(completed).is_complete({'ros', 'dev'})


@pytest.mark.parametrize('path', ['requirements/ros.txt', 'interfaces/vision_msgs/msg/Pose2D.msg'])
def test_other_files_make_it_incomplete(completed, path):
    with (completed / path).open('a') as file:
        file.write('#')
    assert not venv_of(completed).is_complete({'ros'})


def test_moved_environment_is_incomplete(completed):
    assert not venv_of(completed.rename(completed.with_name('moved'))).is_complete({'ros'})


@pytest.mark.parametrize('target', ['/nonexistent/python', '/bin/sh'])
def test_vanished_or_replaced_interpreter_makes_it_incomplete(completed, target):
    python = venv_of(completed).PYTHON
    python.unlink()
    python.symlink_to(target)
    assert not venv_of(completed).is_complete({'ros'})


def test_broken_stamp_makes_it_incomplete(completed):
    venv_of(completed).STAMP.write_text('{"key": ')
    assert not venv_of(completed).is_complete({'ros'})


@pytest.mark.parametrize(('output', 'reason'), [
    ('OSError: [Errno 28] No space left on device', 'the disk is full'),
    ('ERROR: THESE PACKAGES DO NOT MATCH THE HASHES', 'the package index has other files'),
    ("NewConnectionError('Connection refused')", 'the package index cannot be reached'),
    ('ERROR: Could not find a version (from versions: none)', 'the package index cannot'),
    ('this\nthat', 'that'),
])
def test_failing_step_ends_in_one_line(tmp_path, capsys, output, reason):
    path = tmp_path / 'log'
    path.write_text('No space left on device, said of an earlier step\n')
    with pytest.raises(SystemExit) as end, path.open('a') as log:
        _steps.run('step', ['sh', '-c', f'echo "{output}"; exit 3'], log, tmp_path)
    assert end.value.code == 1
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith(f'lowsnr: step failed: {reason}')
    assert line.endswith(f'(all of it is in {path})')


def test_log_is_had_by_one_at_a_time(tmp_path):
    path = tmp_path / 'log'
    with _steps.exclusive_log(path, 'wait'), path.open() as other, pytest.raises(BlockingIOError):
        fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_environ_of_the_wheels_is_not_handed_on(monkeypatch):
    monkeypatch.setenv('LD_LIBRARY_PATH', '/some/lib')
    monkeypatch.delenv('_ROS_WHEELS_BOOTSTRAP_COMPLETE', raising=False)
    assert _steps.environ()['LD_LIBRARY_PATH'] == '/some/lib'
    monkeypatch.setenv('_ROS_WHEELS_BOOTSTRAP_COMPLETE', '1')
    assert {'LD_LIBRARY_PATH', '_ROS_WHEELS_BOOTSTRAP_COMPLETE'}.isdisjoint(_steps.environ())


@pytest.mark.parametrize('name', ['runtime', 'ros', 'dev'])
def test_lock_has_all_that_is_asked_for(name):
    text = (ROOT / 'requirements' / f'{name}.in').read_text('utf-8')
    asked = set(re.findall(r'^[a-z][\w-]*', text, re.MULTILINE))
    assert asked <= set(_venv.packages_of({name}))


def test_windows_packages_are_left_out():
    assert 'tqdm' in _venv.packages_of({'runtime', 'dev'})
    assert 'colorama' not in _venv.packages_of({'runtime', 'dev'})


def test_vision_msgs_are_those_of_every_ros():
    share = Path(vision_msgs.__file__).parents[4] / 'share' / 'vision_msgs'
    hashes = json.loads((share / 'msg' / 'Detection2DArray.json').read_text())['type_hashes']
    name = 'vision_msgs/msg/Detection2DArray'
    assert [x['hash_string'] for x in hashes if x['type_name'] == name] == [HASH]
