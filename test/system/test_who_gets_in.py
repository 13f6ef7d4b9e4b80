"""Who gets in: nobody on another host, unless that is asked for; every node has its enclave."""

import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from graph_runs import own_domain
import psutil
import pytest
import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

TWO_HOSTS = Path(__file__).with_name('two_hosts.py')
NEW_NETWORK = ['unshare', '--map-root-user', '--net']


def reached(results, listens_s, **environment):
    """Return what of a graph reached others; ``environment`` is all that is said of discovery."""
    if subprocess.run([*NEW_NETWORK, 'ip', 'link'], capture_output=True, check=False).returncode:
        pytest.skip('needs to make network namespaces, which this machine does not permit')
    plain = {key: value for key, value in os.environ.items() if key not in (
        'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS', 'ROS_LOCALHOST_ONLY')}
    hosts = subprocess.Popen(
        [*NEW_NETWORK, sys.executable, str(TWO_HOSTS), str(results), str(listens_s)],
        env=plain | {'ROS_DOMAIN_ID': str(own_domain()), 'PYTHONPATH': os.pathsep.join(sys.path),
                     **environment},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        out, err = hosts.communicate(timeout=900.0)
    finally:
        if hosts.poll() is None:
            hosts.send_signal(signal.SIGINT)  # it ends what it started
            hosts.wait(60.0)
    assert hosts.returncode == 0, err
    return json.loads(out)


def test_nobody_on_another_host_hears_or_is_heard(tmp_path):
    assert reached(tmp_path / 'run', 15.0) == {'datagrams': 0, 'neighbour': 1, 'stranger': 0}


def test_the_subnet_hears_when_asked_for(tmp_path):
    found = reached(tmp_path / 'run', 120.0, ROS_AUTOMATIC_DISCOVERY_RANGE='SUBNET')
    assert found.pop('datagrams') > 0
    assert found == {'neighbour': 1, 'stranger': 1}


def test_named_peers_are_let_in(tmp_path):
    found = reached(tmp_path / 'run', 120.0, ROS_STATIC_PEERS='10.65.0.2')
    assert found.pop('datagrams') > 0
    assert found == {'neighbour': 1, 'stranger': 1}


def test_sockets_that_hear_are_bound_to_this_host(bringup):
    domain = own_domain() // 2  # its ports lie below those that sockets for sending get
    run = bringup('--detector', 'cdt', '--loop', '--rate', '50', '--domain-id', str(domain))
    run.wait_for_rows(20, 120.0)
    first = 7400 + 250 * domain
    for pid in [run.process.pid, *run.nodes().values()]:
        bound = {(item.laddr.ip, item.laddr.port)
                 for item in psutil.Process(pid).net_connections('udp4')}
        hearing = {ip for ip, port in bound if first <= port < first + 250}
        assert hearing == {'127.0.0.1'}, bound


@pytest.fixture
def onlooker(monkeypatch):
    """Return a node on the domain of the graphs."""
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=own_domain(),
               signal_handler_options=SignalHandlerOptions.NO)
    node = Node('onlooker', context=context)
    yield node
    node.destroy_node()
    context.try_shutdown()


def test_every_node_is_in_the_enclave_that_bears_its_name(bringup, onlooker):
    run = bringup('--detector', 'cdt', 'sdt', '--loop', '--rate', '50', '--view')
    wanted = {'/bringup', '/evaluator', '/sensor', *(
        f'/{name}/{node}' for name in ('cdt', 'sdt')
        for node in (f'{name}_detector', 'tracker', 'viewer'))}
    found, until = {}, time.monotonic() + 120.0
    while set(found) != wanted:
        assert run.process.poll() is None, run.finish()
        assert time.monotonic() < until, found
        found = {f'{space.rstrip("/")}/{name}': enclave for name, space, enclave
                 in onlooker.get_node_names_and_namespaces_with_enclaves() if name != 'onlooker'}
        time.sleep(0.1)
    assert found == {name: name for name in wanted}
