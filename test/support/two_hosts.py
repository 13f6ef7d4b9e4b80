# SPDX-License-Identifier: Apache-2.0
"""
A graph on one host and strangers on another: two network namespaces with a wire between them.

This script runs in a network namespace of its own (``unshare --net``).  Its arguments are the
results folder and how long a stranger listens [s].  It starts ``bringup.py`` and prints, as JSON,
what reached others: datagrams before anybody contacted the graph, and whether a stranger that
names the graph's host, and a neighbour on the same host, received a frame.
"""

from contextlib import contextmanager
import json
import os
from pathlib import Path
import subprocess
import sys
import time

from graph_runs import BRINGUP
from graph_runs import GraphRun

HOST, OTHER = '10.65.0.1', '10.65.0.2'
PATIENCE_S = 120.0


@contextmanager
def other_host():
    """Make another network namespace, wired to this one; yield the command that enters it."""
    call('ip link set lo up')
    holder = subprocess.Popen(
        ['unshare', '--net', 'sh', '-c', 'echo; exec sleep 600'], stdout=subprocess.PIPE)
    try:
        holder.stdout.readline()  # it is in its namespace
        enter = f'nsenter --target {holder.pid} --net '
        call(f'ip link add here type veth peer name there netns {holder.pid}')
        for prefix, name, address in [('', 'here', HOST), (enter, 'there', OTHER)]:
            call(f'{prefix}ip link set lo up')
            call(f'{prefix}ip address add {address}/24 dev {name}')
            call(f'{prefix}ip link set {name} up')
        yield enter
    finally:
        holder.kill()
        holder.wait()


def call(command):
    """Run a command; return what it prints."""
    return subprocess.run(
        command.split(), stdout=subprocess.PIPE, text=True, check=True, timeout=PATIENCE_S).stdout


def datagrams(enter):
    """Return how many IPv4 packets have come to the other host."""
    names, values = [
        line.split() for line in call(f'{enter}cat /proc/net/snmp').splitlines()
        if line.startswith('Ip: ')]
    return int(values[names.index('InReceives')])


def listen(seconds):
    """Print whether a frame comes within this time."""
    import rclpy
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import Image

    rclpy.init()
    node, received = rclpy.create_node('listener'), []
    node.create_subscription(Image, 'image_raw', received.append, qos_profile_sensor_data)
    until = time.monotonic() + seconds
    while time.monotonic() < until and not received:
        rclpy.spin_once(node, timeout_sec=0.1)
    print(min(1, len(received)))


def receives(seconds, enter='', **environment):
    """Return 1 if a listener that looks beyond its host receives a frame, 0 if not."""
    wide = {**os.environ, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET', **environment}
    done = subprocess.run(
        [*enter.split(), sys.executable, __file__, str(seconds)], env=wide,
        stdout=subprocess.PIPE, check=True, timeout=seconds + PATIENCE_S)
    return int(done.stdout)


def main(results, listens_s):
    """Run the graph until all have listened."""
    with other_host() as enter, GraphRun(subprocess.Popen(
            [sys.executable, str(BRINGUP), '--results', results, '--detector', 'cdt',
             '--loop', '--rate', '50'],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True), Path(results)) as run:
        run.wait_for_rows(200, PATIENCE_S)
        found = datagrams(enter)
        print(json.dumps({
            'datagrams': found, 'neighbour': receives(PATIENCE_S),
            'stranger': receives(float(listens_s), enter, ROS_STATIC_PEERS=HOST)}))


if __name__ == '__main__':
    main(*sys.argv[1:]) if sys.argv[2:] else listen(float(sys.argv[1]))
