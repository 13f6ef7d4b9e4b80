# SPDX-License-Identifier: Apache-2.0
"""Leftovers of the middleware in shared memory: those of killed processes are removed."""

import os
from pathlib import Path
import subprocess
import sys

from graph_runs import graph_environment
from graph_runs import own_domain
from lowsnr_bringup.run.middleware import clear_leftovers
import pytest

# Without a profile of ours, so that it uses shared memory as Fast DDS does by default.
NODE = """
import rclpy
rclpy.init()
node = rclpy.create_node('short_lived')
print('up', flush=True)
rclpy.spin(node)
"""


def start_node(domain_id):
    """Start a process with a node; return it, and the lock files of its segments."""
    process = subprocess.Popen(
        [sys.executable, '-c', NODE], env=graph_environment(domain_id), text=True,
        stdout=subprocess.PIPE)
    assert process.stdout.readline() == 'up\n'
    opened = [Path(os.readlink(link)) for link in Path(f'/proc/{process.pid}/fd').iterdir()]
    return process, {
        path for path in opened if path.name.endswith('_el') and 'port' not in path.name}


def segment_of(lock):
    """Return the segment that a lock file belongs to."""
    return lock.with_name(lock.name.removesuffix('_el'))


@pytest.fixture(scope='module')
def locks():
    """Return the lock files of a process that was killed, and of one that lives."""
    dead, gone = start_node(own_domain())
    living, kept = start_node(own_domain(1))
    dead.kill()
    dead.wait()
    yield gone, kept
    lived = living.poll() is None
    living.kill()
    living.wait()
    for process in (dead, living):
        process.stdout.close()
    assert lived


@pytest.mark.parametrize('made_s', [1.0, 4e9], ids=['long ago', 'before the clock was set back'])
def test_only_segments_of_processes_that_are_gone_are_removed(locks, made_s):
    gone, kept = locks
    assert gone
    assert kept
    for lock in gone | kept:
        segment_of(lock).touch()
        lock.touch()
        os.utime(lock, (made_s, made_s))
    clear_leftovers()  # unless a graph of another test has removed them already
    assert not any(lock.exists() or segment_of(lock).exists() for lock in gone)
    assert all(lock.exists() and segment_of(lock).exists() for lock in kept)


def test_files_of_others_stay(tmp_path):
    names = ['fastrtps_0123456789abcdef', 'fastrtps_port7411', 'fastrtps_port7411_el', 'other_el',
             'fastrtps_short_el']
    for name in (*names, 'fastrtps_0123456789abcdef_el'):
        (tmp_path / name).touch()
    assert clear_leftovers(tmp_path) == 0  # just made: its process may be starting
    os.utime(tmp_path / 'fastrtps_0123456789abcdef_el', (1.0, 1.0))
    for name in names[1:]:
        os.utime(tmp_path / name, (1.0, 1.0))
    assert clear_leftovers(tmp_path) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names[1:])
