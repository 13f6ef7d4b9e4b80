"""Leftovers of the middleware in shared memory: those of killed processes go, no others."""

import os
from pathlib import Path
import signal
import subprocess
import sys

from graph_runs import graph_environment
from graph_runs import own_domain
from lowsnr_eval.shared_memory import clear_leftovers

SHARED = Path('/dev/shm')
NODE = """
import rclpy
rclpy.init()
node = rclpy.create_node('short_lived')
print('up', flush=True)
rclpy.spin(node)
"""


def start_node(before):
    """Start a process with a node; return it and the locks of its segments, as of long ago."""
    process = subprocess.Popen(
        [sys.executable, '-c', NODE], env=graph_environment(own_domain()), text=True,
        stdout=subprocess.PIPE)
    assert process.stdout.readline() == 'up\n'
    held = list(Path(f'/proc/{process.pid}/fd').iterdir())
    locks = {Path(os.readlink(link)) for link in held if os.readlink(link).endswith('_el')}
    locks = {lock for lock in locks if 'port' not in lock.name} - before
    for lock in locks:
        os.utime(lock, (1.0, 1.0))
    return process, locks


def segment(lock):
    """Return the segment that a lock is for."""
    return lock.with_name(lock.name.removesuffix('_el'))


def test_segments_of_a_killed_process_are_removed_and_those_of_others_stay():
    dead, gone = start_node(set())
    living, kept = start_node(gone)
    try:
        assert gone
        assert kept
        dead.send_signal(signal.SIGKILL)
        dead.wait()
        assert all(segment(lock).exists() for lock in gone | kept)
        assert clear_leftovers() >= len(gone)
        assert not any(lock.exists() or segment(lock).exists() for lock in gone)
        assert all(lock.exists() and segment(lock).exists() for lock in kept)
        assert living.poll() is None
    finally:
        for process in (dead, living):
            process.kill()
            process.wait()
            process.stdout.close()


def test_what_is_not_the_middlewares_is_left_alone(tmp_path):
    names = ['fastrtps_0123456789abcdef', 'fastrtps_port7411_el', 'other_el', 'fastrtps_short_el']
    for name in (*names, 'fastrtps_0123456789abcdef_el'):
        (tmp_path / name).touch()
    assert clear_leftovers(tmp_path) == 0  # just made: its process may be starting
    os.utime(tmp_path / 'fastrtps_0123456789abcdef_el', (1.0, 1.0))
    for name in names[1:]:
        os.utime(tmp_path / name, (1.0, 1.0))
    assert clear_leftovers(tmp_path) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names[1:])
