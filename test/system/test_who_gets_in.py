# SPDX-License-Identifier: Apache-2.0
"""No other host reaches a graph unless asked for; every node has its enclave."""

import json
import os
import signal
import subprocess
import sys
import time

from graph_runs import own_domain
from graph_runs import ROOT
from graph_runs import start_bringup
import psutil
import pytest
from ros_nodes import spun_node

TWO_HOSTS = ROOT / 'test' / 'support' / 'two_hosts.py'
NEW_NETWORK = ['unshare', '--map-root-user', '--net']

# How long a stranger listens [s], and the environment variables that widen discovery.
DISCOVERY = {
    'default': (15.0, {}),
    'subnet': (120.0, {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'}),
    'peers': (120.0, {'ROS_STATIC_PEERS': '10.65.0.2'})}


def start_hosts(results, domain, listens_s, discovery):
    """Start two hosts with a graph on one of them, with no other setting of discovery."""
    plain = {key: value for key, value in os.environ.items() if key not in (
        'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS', 'ROS_LOCALHOST_ONLY')}
    return subprocess.Popen(
        [*NEW_NETWORK, sys.executable, str(TWO_HOSTS), str(results), str(listens_s)],
        env=plain | {'ROS_DOMAIN_ID': str(domain), 'PYTHONPATH': os.pathsep.join(sys.path),
                     **discovery},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.fixture
def reached(tmp_path):
    """Return a function that gives what reached others of a graph with a setting of discovery."""
    if subprocess.run([*NEW_NETWORK, 'ip', 'link'], capture_output=True, check=False).returncode:
        pytest.skip('needs to make network namespaces, which this machine does not permit')

    def look(name):
        hosts = start_hosts(tmp_path / name, own_domain(), *DISCOVERY[name])
        try:
            out, err = hosts.communicate(timeout=900.0)
        finally:
            if hosts.poll() is None:
                hosts.send_signal(signal.SIGINT)  # it ends what it started
                hosts.wait(60.0)
        assert hosts.returncode == 0, err
        return json.loads(out)
    return look


def test_nothing_reaches_another_host_by_default(reached):
    assert reached('default') == {'datagrams': 0, 'neighbour': 1, 'stranger': 0}


@pytest.mark.slow
@pytest.mark.parametrize('setting', ['subnet', 'peers'])
def test_those_receive_who_are_asked_for(reached, setting):
    found = reached(setting)
    assert found.pop('datagrams') > 0
    assert found == {'neighbour': 1, 'stranger': 1}


@pytest.fixture(scope='module')
def running(tmp_path_factory):
    """Return a run of two chains with viewers, on the domain that an option names."""
    domain = own_domain(3)
    with start_bringup(
            tmp_path_factory.mktemp('running') / 'run', '--detector', 'cdt', 'sdt', '--loop',
            '--rate', '20', '--view', '--domain-id', str(domain), domain_id=own_domain()) as run:
        run.wait_for_rows(20)
        yield run, domain


def test_every_node_is_in_the_enclave_of_its_name(running):
    run, domain = running
    wanted = {'/bringup', '/evaluator', '/sensor', *(
        f'/{name}/{node}' for name in ('cdt', 'sdt')
        for node in (f'{name}_detector', 'tracker', 'viewer'))}
    found, until = {}, time.monotonic() + 120.0
    with spun_node('onlooker', domain) as (node, _):
        while set(found) != wanted:
            assert run.process.poll() is None, run.finish()
            assert time.monotonic() < until, found
            found = {
                f'{space.rstrip("/")}/{name}': enclave for name, space, enclave
                in node.get_node_names_and_namespaces_with_enclaves() if name != 'onlooker'}
            time.sleep(0.1)
    assert found == {name: name for name in wanted}


def test_receiving_sockets_are_bound_to_this_host(running):
    run, domain = running
    first = 7400 + 250 * domain
    for pid in [run.process.pid, *(pid for _, pid in run.processes())]:
        bound = {(item.laddr.ip, item.laddr.port)
                 for item in psutil.Process(pid).net_connections('udp4')}
        receiving = {ip for ip, port in bound if first <= port < first + 250}
        assert receiving == {'127.0.0.1'}, bound
