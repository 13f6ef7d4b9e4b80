# SPDX-License-Identifier: Apache-2.0
"""The making of ``.venv``: when it is complete, what a step prints, what the locks hold."""

import errno
import fcntl
import importlib.util
import json
from pathlib import Path
import sys

import _environment
import _steps
import _venv
import pytest
import vision_msgs

ROOT = Path(__file__).resolve().parents[2]
LOCKS = ('runtime', *_environment.EXTRAS, 'ros', 'dev')
HASH = 'RIHS01_214274120007f4a683866481336b70310268cfa107aebe9d594a6acf75bda968'


def venv_of(checkout):
    """Return the module ``_venv`` of a checkout."""
    path = checkout / 'scripts' / '_venv.py'
    spec = importlib.util.spec_from_file_location('venv_of_checkout', path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def completed(checkout):
    """Return a checkout whose environment has the stamp of a complete one."""
    venv = venv_of(checkout)
    venv.PYTHON.parent.mkdir(parents=True)
    venv.PYTHON.symlink_to(sys._base_executable)
    venv.STAMP.write_text(json.dumps({'key': venv._key(), 'contents': ['ros']}))
    assert venv.is_complete({'ros'})
    return checkout


def test_environment_is_incomplete_without_a_wanted_lock(completed):
    assert not venv_of(completed).is_complete({'ros', 'dev'})


@pytest.mark.parametrize('path', ['requirements/ros.txt', 'interfaces/vision_msgs/msg/Pose2D.msg'])
def test_environment_made_from_other_files_is_incomplete(completed, path):
    with (completed / path).open('a') as file:
        file.write('#')
    assert not venv_of(completed).is_complete({'ros'})


def test_environment_whose_files_change_while_it_is_made_is_incomplete(completed, monkeypatch):
    venv = venv_of(completed)

    def run(title, command, log, place):
        with (venv.LOCKS / 'ros.txt').open('a') as file:
            file.write('#')

    monkeypatch.setattr(_steps, 'run', run)
    with venv.LOG.open('w') as log, pytest.raises(SystemExit) as ended:
        venv._take_steps('ros', {'ros', 'dev'}, {}, log)
    assert ended.value.code == 1
    assert not venv.is_complete({'ros'})


def test_moved_environment_is_incomplete(completed):
    assert not venv_of(completed.rename(completed.with_name('moved'))).is_complete({'ros'})


@pytest.mark.parametrize('target', ['/nonexistent/python', '/bin/sh'])
def test_environment_without_its_interpreter_is_incomplete(completed, target):
    python = venv_of(completed).PYTHON
    python.unlink()
    python.symlink_to(target)
    assert not venv_of(completed).is_complete({'ros'})


@pytest.mark.parametrize('has_links', [True, False])
def test_equal_libraries_take_room_once_where_links_are_to_be_had(
        completed, monkeypatch, has_links):
    venv = venv_of(completed)
    texts = {'libx.so': b'x', 'libx.so.1': b'x', 'libx.so.1.2': b'x', 'liby.so': b'y'}
    (venv.VENV / 'lib').mkdir()
    for name, text in (texts | {'libx.so.1.link': b''}).items():  # an interrupted start left one
        (venv.VENV / 'lib' / name).write_bytes(text)
    if not has_links:
        monkeypatch.setattr(venv.os, 'link', refuse)
    for _ in range(2):
        venv._link_copies()
        found = {path.name: path for path in (venv.VENV / 'lib').iterdir()}
        assert {name: path.read_bytes() for name, path in found.items()} == texts
        assert len({path.stat().st_ino for path in found.values()}) == (2 if has_links else 4)


def refuse(*_):
    """Be a file system without links."""
    raise PermissionError(errno.EPERM, 'Operation not permitted')


@pytest.mark.parametrize('text', [
    '{"key": ', '[]', '{}', '"text"', 'null', '[' * 100_000, '{"key": 1, "contents": 1}',
    '\udcff'])
def test_environment_with_a_broken_stamp_is_incomplete(completed, text):
    venv_of(completed).STAMP.write_text(text, errors='surrogateescape')
    assert not venv_of(completed).is_complete({'ros'})


@pytest.mark.parametrize(('output', 'culprit'), [
    ('OSError: [Errno 28] No space left on device', ' disk '),
    ('ERROR: THESE PACKAGES DO NOT MATCH THE HASHES', ' requirements/*.txt '),
    ("NewConnectionError('Connection refused')", ' network'),
    ('ERROR: Could not find a version (from versions: none)', ' network'),
    ('this\nthat', ' that '),
])
def test_failing_step_ends_with_one_line_that_names_the_culprit(
        tmp_path, capsys, output, culprit):
    path = tmp_path / 'log'
    path.write_text('No space left on device, from an earlier step\n')
    with pytest.raises(SystemExit) as end, path.open('a') as log:
        _steps.run('step', ['sh', '-c', f'echo "{output}"; exit 3'], log, tmp_path)
    assert end.value.code == 1
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith('lowsnr: step failed: ')
    assert culprit in line
    assert str(path) in line


def test_log_is_open_in_one_process_at_a_time(tmp_path):
    path = tmp_path / 'log'
    with _steps.exclusive_log(path, 'wait'), path.open() as other, pytest.raises(BlockingIOError):
        fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_children_do_not_inherit_the_variables_of_the_wheels(monkeypatch):
    monkeypatch.setenv('LD_LIBRARY_PATH', '/some/lib')
    monkeypatch.delenv('_ROS_WHEELS_BOOTSTRAP_COMPLETE', raising=False)
    assert _steps.environ()['LD_LIBRARY_PATH'] == '/some/lib'
    monkeypatch.setenv('_ROS_WHEELS_BOOTSTRAP_COMPLETE', '1')
    assert {'LD_LIBRARY_PATH', '_ROS_WHEELS_BOOTSTRAP_COMPLETE'}.isdisjoint(_steps.environ())


@pytest.mark.parametrize('name', LOCKS)
def test_lock_has_all_packages_of_its_input(name):
    asked = set(_venv.asked_of([name]))
    assert asked
    assert asked <= set(_venv.packages_of({name}))


def test_locks_agree_on_every_version():
    versions = {}
    for name in LOCKS:
        for package, lines in _venv.packages_of({name}).items():
            versions.setdefault(package, set()).add(lines.split()[0])
    assert {found for found in map(frozenset, versions.values()) if len(found) > 1} == set()


def test_environment_of_a_run_lacks_what_only_some_commands_need():
    least = set(_venv.packages_of({'runtime', 'ros'}))
    for extra in _environment.EXTRAS:
        assert not least & set(_venv.asked_of([extra]))
    assert set(_venv.BUILD_ONLY) <= least  # and are removed once vision_msgs is built


def test_windows_packages_are_left_out():
    assert 'tqdm' in _venv.packages_of({'runtime', 'dev'})
    assert 'colorama' not in _venv.packages_of({'runtime', 'dev'})


def test_vision_msgs_are_those_of_every_ros():
    share = Path(vision_msgs.__file__).parents[4] / 'share' / 'vision_msgs'
    hashes = json.loads((share / 'msg' / 'Detection2DArray.json').read_text())['type_hashes']
    name = 'vision_msgs/msg/Detection2DArray'
    assert [x['hash_string'] for x in hashes if x['type_name'] == name] == [HASH]
