# SPDX-License-Identifier: Apache-2.0
"""Which ros2 the environment gives: an installed one, or the small one where there is none."""

import os
from pathlib import Path
import subprocess
import sys

import _venv
from lowsnr_bringup.cli.executables import installed_executable
import pytest
import ros2

SCRIPT = Path(ros2.__file__)


def command(path, text):
    """Write an executable that prints."""
    path.parent.mkdir(parents=True)
    path.write_text(f'#!/bin/sh\n{text}\n')
    path.chmod(0o755)
    return path


@pytest.fixture
def linked(tmp_path, monkeypatch):
    """Return the folder of an environment's commands, among them ros2, and make it the path."""
    monkeypatch.setattr(_venv, 'VENV', tmp_path / '.venv')
    folder = tmp_path / '.venv' / 'bin'
    folder.mkdir(parents=True)
    for _ in range(2):  # the second start finds it
        _venv.give_ros2()
    monkeypatch.setenv('PATH', str(folder))
    return folder


def test_environment_gets_the_command_of_its_checkout(linked, monkeypatch):
    assert (linked / 'ros2').resolve() == SCRIPT
    assert os.access(linked / 'ros2', os.X_OK)
    assert ros2.installed_command() is None
    monkeypatch.setattr(_venv, 'VENV', linked / 'nowhere')
    _venv.give_ros2()
    assert not (linked / 'nowhere').exists()


def test_installed_ros2_is_used_with_all_arguments(linked, tmp_path):
    installed = command(tmp_path / 'jazzy' / 'bin' / 'ros2', 'echo installed "$@"; exit 5')
    done = subprocess.run(
        [sys.executable, linked / 'ros2', 'topic', 'pub', 'a b'], capture_output=True, text=True,
        env=os.environ | {'PATH': os.pathsep.join([str(linked), str(installed.parent)])})
    assert (done.returncode, done.stdout) == (5, 'installed topic pub a b\n')


def test_line_to_copy_has_all_that_decides_what_is_discovered(linked, monkeypatch):
    for name in ros2.DECIDING:
        monkeypatch.delenv(name, raising=False)
    assert ros2.line_to_copy('topic', 'list') == f'ROS_DOMAIN_ID=0 {SCRIPT} topic list'
    monkeypatch.setenv('ROS_DOMAIN_ID', '7')
    monkeypatch.setenv('ROS_STATIC_PEERS', 'a;b')
    assert ros2.line_to_copy('topic', 'echo', '/tracks') == (
        f"ROS_DOMAIN_ID=7 ROS_STATIC_PEERS='a;b' {SCRIPT} topic echo /tracks")


def test_line_to_copy_sources_an_installed_ros(linked, tmp_path, monkeypatch):
    installed = command(tmp_path / 'jazzy' / 'bin' / 'ros2', 'echo "$ROS_DOMAIN_ID $SOURCED"')
    (tmp_path / 'jazzy' / 'setup.sh').write_text('export SOURCED=yes\n')
    monkeypatch.setenv('PATH', os.pathsep.join([str(installed.parent), '/usr/bin', '/bin']))
    monkeypatch.setenv('ROS_DOMAIN_ID', '9')
    line = ros2.line_to_copy('topic', 'list')
    out = subprocess.check_output(['sh', '-c', line], env={'PATH': '/usr/bin:/bin'}, text=True)
    assert out == '9 yes\n'


def test_run_starts_a_node_of_the_checkout(linked):
    done = subprocess.run(
        [sys.executable, SCRIPT, 'run', 'lowsnr_sensor', 'sensor_node', '--ros-args', '-p',
         'rate_hz:=-1.0'], capture_output=True, text=True,
        env=os.environ | {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'})
    assert (done.returncode, done.stderr.count('\n')) == (2, 1)  # the node's own, for its setting
    assert 'rate_hz' in done.stderr


def test_executables_of_installed_packages_come_first(tmp_path, monkeypatch):
    index = tmp_path / 'share' / 'ament_index' / 'resource_index' / 'packages'
    index.mkdir(parents=True)
    (index / 'lowsnr_sensor').touch()
    path = command(tmp_path / 'lib' / 'lowsnr_sensor' / 'sensor_node', 'exit 3')
    monkeypatch.setenv('AMENT_PREFIX_PATH', os.pathsep.join(['', str(tmp_path)]))
    assert installed_executable('lowsnr_sensor', 'sensor_node') == path
    assert installed_executable('lowsnr_detect', 'sdt_node') is None
    path.chmod(0o644)
    with pytest.raises(ValueError, match='sensor_node'):
        installed_executable('lowsnr_sensor', 'sensor_node')
