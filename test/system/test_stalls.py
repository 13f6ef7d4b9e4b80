# SPDX-License-Identifier: Apache-2.0
"""Stopped nodes, a flood of messages, and a network that fails: the graph recovers by itself."""

import functools
import os
import shutil
import signal
import subprocess
import sys
import time

from graph_runs import BRINGUP
from graph_runs import graph_environment
from graph_runs import GraphRun
from graph_runs import own_domain
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from run_checks import check_end
from run_checks import check_frames
from run_checks import first_answer_after
from run_checks import interrupt
from run_checks import wait_for_all_scored
from tally import FAULTS
from vision_msgs.msg import Detection2DArray

NODES = ('sensor_node', 'detector_node', 'tracker_node', 'evaluator_node', 'viewer_node')
RUN = ('--detector', 'cdt', '--scenario', 'three_objects', '--loop', '--rate', '20')
FLOOD, PER_SECOND = 15_000, 5000
MOST_GROWTH_MIB = 200
WITHOUT_NETWORK_S = 10.0


def test_nodes_that_are_stopped_at_any_frame_lose_nothing(bringup, client):
    rng = np.random.default_rng(5)
    run = bringup(*RUN, '--view')
    run.wait_for_rows(20)
    for _ in range(3):
        for module in rng.permutation(NODES):
            run.wait_for_rows(len(run.rows()) + 2 * int(rng.integers(1, 10)))
            pid = run.nodes()[module]
            os.kill(pid, signal.SIGSTOP)
            client.spin(float(rng.uniform(0.1, 1.0)))
            os.kill(pid, signal.SIGCONT)
            FAULTS['SIGSTOP'] += 1
    wait_for_all_scored(run, client)
    lines = interrupt(run)
    check_end(run, 130)
    check_frames(run, lines)


def memory_mib(pid):
    """Return the resident memory of a process."""
    with open(f'/proc/{pid}/statm', encoding='ascii') as file:
        return int(file.read().split()[1]) * os.sysconf('SC_PAGE_SIZE') / 2**20


def test_flood_is_survived_in_bounded_memory(bringup, client):
    run = bringup(*RUN)
    run.wait_for_rows(20)
    client.connect(Detection2DArray, '/detections')
    readers = [run.nodes()[module] for module in ('tracker_node', 'evaluator_node')]
    before = [memory_mib(pid) for pid in readers]
    message = Detection2DArray()
    start = time.monotonic()
    for n in range(FLOOD):
        message.header.stamp = client.next_stamp('/detections')
        client.send('/detections', serialize_message(message), 'flood')
        if n % 50 == 49:
            client.spin(max(0.0, start + (n + 1) / PER_SECOND - time.monotonic()))
    grown = [memory_mib(pid) - was for pid, was in zip(readers, before)]
    assert max(grown) < MOST_GROWTH_MIB
    client.disconnect('/detections')
    client.spin(1.0)  # it may not have received all frames yet
    newest = client.newest_s('/image_raw')
    recovered = client.wait(lambda: first_answer_after(run, newest))
    run.wait_for_rows(recovered + 80)
    lines = interrupt(run)
    check_end(run, 130)
    check_frames(run, lines, loose=FLOOD)
    silent = [row for row in run.rows()[recovered:recovered + 80] if not row.split(',')[5]]
    assert not silent


@pytest.fixture(scope='module')
def lone(tmp_path_factory):
    """Return a graph in its own network and the command that changes it; None if not allowed."""
    own, into = (([], []) if os.geteuid() == 0 else (['-r'], ['-U', '--preserve-credentials']))
    if not all(map(shutil.which, ('unshare', 'nsenter', 'ip'))) or subprocess.run(
            ['unshare', *own, '-n', 'true'], capture_output=True, check=False).returncode:
        yield None
        return
    results = tmp_path_factory.mktemp('lone') / 'run'
    with GraphRun(subprocess.Popen(
            ['unshare', *own, '-n', 'sh', '-c', 'ip link set lo up && exec "$@"', 'sh',
             sys.executable, BRINGUP, '--results', results, *RUN],
            env=graph_environment(own_domain(1)), stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True), results) as run:
        run.wait_for_rows(20)
        yield run, ['nsenter', '-t', str(run.process.pid), *into, '-n', 'ip']


@pytest.fixture(scope='module')
def outage(lone):
    """Return a function that waits; at its first call, the network of `lone` is down meanwhile."""
    @functools.cache
    def wait():
        if lone is None:
            time.sleep(WITHOUT_NETWORK_S)
            return
        _, inside = lone
        subprocess.run([*inside, 'link', 'set', 'lo', 'down'], check=True)
        time.sleep(WITHOUT_NETWORK_S)
        subprocess.run([*inside, 'link', 'set', 'lo', 'up'], check=True)
        FAULTS['network gone'] += 1
    return wait


def test_every_datagram_may_be_lost_for_ten_seconds(bringup, host_faults, outage):
    run = bringup(*RUN)
    run.wait_for_rows(20)
    host_faults.lose_datagrams(1.0)
    outage()
    host_faults.lose_datagrams(0.0)
    check_that_it_goes_on(run)


def test_network_may_be_gone_for_ten_seconds(lone, outage, require_program):
    for name in ('unshare', 'nsenter', 'ip'):
        require_program(name)
    if lone is None:
        pytest.skip('needs a network of its own, which is not allowed here; the test before '
                    'loses datagrams instead')
    outage()
    check_that_it_goes_on(lone[0])


def check_that_it_goes_on(run):
    """Check that frames are scored after an outage, and what the run holds at its end."""
    run.wait_for_rows(len(run.rows()) + 80)
    lines = interrupt(run)
    check_end(run, 130)
    check_frames(run, lines)
