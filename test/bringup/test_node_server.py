# SPDX-License-Identifier: Apache-2.0
"""Nodes forked from a server: processes of their own, and no run depends on the server."""

import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from lowsnr_bringup.plan.graph import Node
from lowsnr_bringup.run.forked_nodes import ForkedProcess
from lowsnr_bringup.run.forked_nodes import NodeServer
from lowsnr_bringup.run.forked_nodes import ServerGone
from lowsnr_bringup.run.processes import ProcessGroup
import psutil
import pytest

# Says what process it is, and ends as its second word asks.
MODULE = """
import os
from pathlib import Path
import sys
import threading
import time
def preload(*words):
    sys.made_preloaded = f'{os.getppid()},{",".join(words)}'
    Path(__file__).with_name('preloaded').touch()
if __name__ == '__main__':
    from lowsnr_common.core.process_setup import end_with_starter
    print(sys.argv[1:3], os.getpid(), os.getsid(0), os.environ.get('MARK'),
          'rclpy' in sys.modules, getattr(sys, 'made_preloaded', None), flush=True)
    end_with_starter()
    if sys.argv[2] == 'wait':
        print('waits', flush=True)
        time.sleep(600.0)
    elif sys.argv[2] == 'raise':
        raise RuntimeError('as asked')
    sys.exit(int(sys.argv[2]))
"""
# Its loop is compiled at its first call.
LOOP = """
from lowsnr_common.core.compiled import compiled
@compiled
def increased(x):
    return x + 1
def preload():
    increased(1)
"""
ENDS_WITHIN_S = 30.0


@pytest.fixture
def environment(tmp_path):
    """Return an environment in which the module of the test can be imported."""
    (tmp_path / 'made_for_test.py').write_text(MODULE)
    (tmp_path / 'made_loop.py').write_text(LOOP)
    return {**os.environ, 'PYTHONPATH': os.pathsep.join([str(tmp_path), *sys.path])}


@pytest.fixture
def server(environment, monkeypatch):
    """Return a server that imports in this environment."""
    monkeypatch.setenv('PYTHONPATH', environment['PYTHONPATH'])
    with NodeServer(('made_for_test', 'one', 'two')) as started:
        yield started


def node(word):
    """Return a node that ends as a word says."""
    return Node(f'made_{word}', 'made_for_test', '', ('first', word))


def wait_for(condition):
    """Wait until a condition holds."""
    until = time.monotonic() + ENDS_WITHIN_S
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.01)


@pytest.fixture
def group(tmp_path, environment, server):
    """Return a group whose processes are forked."""
    with ProcessGroup(tmp_path / 'log', {**environment, 'MARK': 'mine'}, server) as made:
        yield made


@pytest.mark.parametrize(('word', 'status', 'logged'), [
    ('0', 0, "['first', '0']"), ('3', 3, "['first', '3']"), ('raise', 1, 'RuntimeError')])
def test_exit_status_and_output_are_those_of_a_process(group, tmp_path, word, status, logged):
    member = group.start(node(word), tmp_path / 'none.yaml')
    assert isinstance(member.process, ForkedProcess)
    assert member.process.wait(ENDS_WITHIN_S) == status
    assert group.dead() == [member]
    assert logged in member.log.read_text()


def test_forked_node_is_a_process_of_its_own(group, tmp_path, server):
    wait_for((tmp_path / 'preloaded').exists)
    member = group.start(node('wait'), tmp_path / 'none.yaml')
    wait_for(lambda: 'waits' in member.log.read_text())
    pid = member.process.pid
    words, rest = member.log.read_text().splitlines()[0].split('] ')
    assert words == "['first', 'wait'"
    # Process id, session, environment, whether rclpy was there before the node imported it, and
    # what the module loaded in the server, a child of this process, with its arguments.
    assert rest.split() == [str(pid), str(pid), 'mine', 'True', f'{os.getpid()},one,two']
    assert psutil.Process(pid).ppid() == os.getpid()
    command = Path(f'/proc/{pid}/cmdline').read_bytes().replace(b'\0', b' ').decode().split()
    assert command[1:5] == ['-m', 'made_for_test', 'first', 'wait']
    assert str(tmp_path / 'none.yaml') in command
    opened = {os.readlink(path) for path in Path(f'/proc/{pid}/fd').iterdir()}
    assert str(member.log) in opened
    # The line to bring-up, and not the channel of the server.
    assert len([path for path in opened if path.startswith('socket:')]) == 1


@pytest.mark.parametrize('number', [signal.SIGKILL, signal.SIGTERM])
def test_signal_that_ended_a_node_is_known(group, tmp_path, number):
    member = group.start(node('wait'), tmp_path / 'none.yaml')
    wait_for(lambda: 'waits' in member.log.read_text())
    os.kill(member.process.pid, number)
    assert member.process.wait(ENDS_WITHIN_S) == -number


@pytest.mark.parametrize('number', [signal.SIGKILL, signal.SIGTERM])
def test_nodes_outlive_the_server_and_the_next_are_spawned(group, tmp_path, server, number):
    before = group.start(node('wait'), tmp_path / 'none.yaml')
    os.kill(server.process.pid, number)
    wait_for(lambda: psutil.Process(server.process.pid).status() == psutil.STATUS_ZOMBIE)
    after = group.start(node('3'), tmp_path / 'none.yaml')
    assert isinstance(after.process, subprocess.Popen)
    assert after.process.wait(ENDS_WITHIN_S) == 3
    assert before.process.poll() is None
    os.kill(before.process.pid, signal.SIGKILL)
    assert before.process.wait(ENDS_WITHIN_S) == -signal.SIGKILL


def test_server_compiles_nothing(tmp_path, environment, monkeypatch):
    cache = tmp_path / 'cache'
    for name in ('PYTHONPATH', 'NUMBA_CACHE_DIR'):
        monkeypatch.setenv(name, {**environment, 'NUMBA_CACHE_DIR': str(cache)}[name])
    detector = ('lowsnr_detect.node.warm_up', 'sdt', 'matched')
    with NodeServer(('made_loop',), detector, ('made_for_test',)) as server, (
            ProcessGroup(tmp_path / 'log', os.environ, server)) as group:
        wait_for((tmp_path / 'preloaded').exists)
        member = group.start(node('0'), tmp_path / 'none.yaml')
        assert isinstance(member.process, ForkedProcess)
        assert member.process.wait(ENDS_WITHIN_S) == 0
    assert not [*cache.rglob('*.nbc')]


def test_server_outlives_what_it_cannot_load_and_loads_the_rest(
        tmp_path, environment, monkeypatch):
    monkeypatch.setenv('PYTHONPATH', environment['PYTHONPATH'])
    (tmp_path / 'made_broken.py').write_text('def preload():\n    raise OSError(28, "full")\n')
    broken = [('made_broken',), ('made_nowhere',), ('lowsnr_detect.node.warm_up', 'no detector')]
    with NodeServer(*broken, ('made_for_test',)) as server, ProcessGroup(
            tmp_path / 'log', environment, server) as group:
        wait_for((tmp_path / 'preloaded').exists)
        member = group.start(node('3'), tmp_path / 'none.yaml')
        assert isinstance(member.process, ForkedProcess)
        assert member.process.wait(ENDS_WITHIN_S) == 3


def test_server_loads_all_at_once_after_one_quiet_time(tmp_path, environment, monkeypatch):
    monkeypatch.setenv('PYTHONPATH', environment['PYTHONPATH'])
    (tmp_path / 'made_note.py').write_text("""
from pathlib import Path
import time
def preload(word):
    with Path(__file__).with_name('noted').open('a') as file:
        file.write(f'{time.monotonic()}\\n')
""")
    with NodeServer(*[('made_note', str(n)) for n in range(8)]):
        noted = tmp_path / 'noted'
        wait_for(lambda: noted.exists() and len(noted.read_text().splitlines()) == 8)
    times = [float(each) for each in noted.read_text().splitlines()]
    assert min(later - time for time, later in zip(times[:-1], times[1:], strict=True)) < 1.0


def test_server_has_only_the_threads_that_rclpy_starts(environment, tmp_path, monkeypatch):
    """A thread that takes a lock would keep it locked in every forked node."""
    monkeypatch.setenv('PYTHONPATH', environment['PYTHONPATH'])
    code = 'import psutil, rclpy; print(psutil.Process().num_threads())'
    bare = subprocess.run([sys.executable, '-c', code], capture_output=True, check=True)
    with NodeServer(
            ('lowsnr_sensor.conditioner_node',),
            ('lowsnr_detect.node.warm_up', 'auto', 'adaptive'), ('made_for_test',)) as server:
        wait_for((tmp_path / 'preloaded').exists)
        assert psutil.Process(server.process.pid).num_threads() == int(bare.stdout)


def test_server_that_is_gone_says_so(server, environment):
    server.close()
    for _ in range(2):
        with pytest.raises(ServerGone):
            server.fork('made_for_test', [], environment, 1, 0)


STARTER = """
import sys
from pathlib import Path
from lowsnr_bringup.plan.graph import Node
from lowsnr_bringup.run.forked_nodes import NodeServer
from lowsnr_bringup.run.processes import ProcessGroup
import os
with NodeServer() as server, ProcessGroup(Path(sys.argv[1]), os.environ, server) as group:
    member = group.start(Node('made', 'made_for_test', '', ('first', 'wait')), Path('none.yaml'))
    while 'waits' not in member.log.read_text():
        pass
    print(member.process.pid, server.process.pid, flush=True)
    sys.stdin.read()
"""


def test_node_and_server_end_with_a_killed_starter(environment, tmp_path):
    with subprocess.Popen(
            [sys.executable, '-c', STARTER, str(tmp_path / 'log')], env=environment, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE) as starter:
        pids = [int(word) for word in starter.stdout.readline().split()]
        assert len(pids) == 2
        starter.kill()
    wait_for(lambda: not any(map(psutil.pid_exists, pids)))
