"""Leftovers of the middleware in shared memory: those of killed processes go."""

import os
import subprocess
import sys

from dying_sender import die_in
from dying_sender import open_files
from dying_sender import port_of
from dying_sender import sending_to
from graph_runs import graph_environment
from graph_runs import own_domain
from lowsnr_bringup.run.shared_memory import clear_leftovers
from lowsnr_bringup.run.shared_memory import close_ports
from lowsnr_bringup.run.shared_memory import free_ports
from lowsnr_bringup.run.shared_memory import MUTEXES_AT
import pytest

NODE = """
import rclpy
rclpy.init()
node = rclpy.create_node('short_lived')
print('up', flush=True)
rclpy.spin(node)
"""


def start_node(domain_id):
    """Start a process with a node; return it, and the locks of its segments and of its ports."""
    process = subprocess.Popen(
        [sys.executable, '-c', NODE], env=graph_environment(domain_id), text=True,
        stdout=subprocess.PIPE)
    assert process.stdout.readline() == 'up\n'
    locks = {path for path in open_files(process.pid) if path.name.endswith('_el')}
    ports = {lock for lock in locks if 'port' in lock.name}
    return process, locks - ports, ports


def guarded(lock):
    """Return the segment or port that a lock is for."""
    return lock.with_name(lock.name.removesuffix('_el'))


@pytest.fixture(scope='module')
def processes():
    """Return the locks of a process that was killed, and of one that lives, and its id."""
    dead, *gone = start_node(own_domain())
    living, *kept = start_node(own_domain(1))  # it does not use the ports of the other
    dead.kill()
    dead.wait()
    yield gone, kept, living.pid
    lived = living.poll() is None
    living.kill()
    living.wait()
    for process in (dead, living):
        process.stdout.close()
    assert lived


@pytest.mark.parametrize('made_s', [1.0, 4e9], ids=['long ago', 'before the clock was set back'])
def test_segments_of_a_killed_process_are_removed_and_those_of_others_stay(processes, made_s):
    (gone, _), (kept, _), _ = processes
    assert gone
    assert kept
    for lock in gone | kept:
        guarded(lock).touch()
        lock.touch()
        os.utime(lock, (made_s, made_s))
    clear_leftovers()  # unless a graph of another test has removed them already
    assert not any(lock.exists() or guarded(lock).exists() for lock in gone)
    assert all(lock.exists() and guarded(lock).exists() for lock in kept)


def test_ports_of_a_killed_process_are_closed_and_those_of_others_stay(processes):
    (_, gone), (_, kept), _ = processes
    assert gone
    assert kept
    before = {lock: guarded(lock).read_bytes() for lock in gone}
    assert close_ports() >= len(gone)
    for lock in gone:
        changed = [n for n, (old, new) in enumerate(
            zip(before[lock], guarded(lock).read_bytes(), strict=True)) if old != new]
        assert len(changed) == 1
        assert before[lock][changed[0]] & 1
    assert all(guarded(lock).read_bytes()[changed[0]] & 1 for lock in kept)


@pytest.mark.parametrize('offset', MUTEXES_AT)
def test_what_a_killed_sender_left_locked_is_unlocked_and_what_another_holds_is_not(
        processes, offset):
    port = port_of(processes[-1])
    free_ports()  # what others left
    die_in(port, offset)
    assert free_ports() == 1
    with sending_to(port, offset):
        assert free_ports() == 0


def test_what_is_not_the_middlewares_is_left_alone(tmp_path):
    names = ['fastrtps_0123456789abcdef', 'fastrtps_port7411', 'fastrtps_port7411_el',
             'fastrtps_port7412', 'fastrtps_port7412_el', 'fastrtps_port7413',
             'fastrtps_port7413_el', 'other_el', 'fastrtps_short_el']
    for name in (*names, 'fastrtps_0123456789abcdef_el'):
        (tmp_path / name).touch()
    (tmp_path / 'fastrtps_port7412').write_bytes(bytes(50_000))
    (tmp_path / 'fastrtps_port7413').write_bytes(b'port_node_abi5')
    assert close_ports(tmp_path) == free_ports(tmp_path) == 0
    assert (tmp_path / 'fastrtps_port7412').read_bytes() == bytes(50_000)
    assert clear_leftovers(tmp_path) == 0  # just made: its process may be starting
    os.utime(tmp_path / 'fastrtps_0123456789abcdef_el', (1.0, 1.0))
    for name in names[1:]:
        os.utime(tmp_path / name, (1.0, 1.0))
    assert clear_leftovers(tmp_path) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names[1:])
