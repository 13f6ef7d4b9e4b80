# SPDX-License-Identifier: Apache-2.0
"""The profile of the middleware: its transport, its reach, and that a user's own comes first."""

from argparse import Namespace
import os
import xml.etree.ElementTree as ElementTree

from _network import set_environment
from lowsnr_bringup.run.middleware import middleware_environment
from lowsnr_bringup.run.middleware import PROFILE_FILE
import pytest

SPACE = '{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}'
FAST_DDS = 'rmw_fastrtps_cpp'
VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'


def profile(folder, **environment):
    """Return the profile that is written in an environment, and the variables but its path."""
    added = middleware_environment(environment, folder, FAST_DDS)
    assert {added.pop(name) for name in VARIABLES} == {str(folder / PROFILE_FILE)}
    return ElementTree.parse(folder / PROFILE_FILE).getroot(), added


def texts(root, path):
    """Return the texts of all elements at a path."""
    return [item.text for item in root.iterfind('.//' + '/'.join(
        SPACE + part for part in path.split('/')))]


@pytest.mark.parametrize('environment', [{}, {RANGE: 'LOCALHOST'}])
def test_udp_is_the_only_transport(tmp_path, environment):
    root, added = profile(tmp_path, **environment)
    assert texts(root, 'type') == ['UDPv4']
    assert texts(root, 'useBuiltinTransports') == ['false']
    assert texts(root, 'userTransports/transport_id') == texts(
        root, 'transport_descriptor/transport_id')
    assert int(texts(root, 'receiveBufferSize')[0]) >= 4 * 2 * 4096**2
    assert added['RMW_FASTRTPS_USE_QOS_FROM_XML'] == '1'


@pytest.mark.parametrize(('environment', 'sockets', 'peers'), [
    ({}, [], []),
    ({RANGE: ''}, [], []),
    ({RANGE: 'SUBNET'}, [], []),
    ({RANGE: 'SYSTEM_DEFAULT'}, [], []),
    ({RANGE: 'SUBNET', 'ROS_STATIC_PEERS': '10.0.0.2'}, [], []),  # ROS adds the peers itself
    ({RANGE: 'LOCALHOST'}, ['127.0.0.1'], ['127.0.0.1']),
    ({RANGE: 'LOCALHOST', 'ROS_STATIC_PEERS': '10.0.0.2;10.0.0.3'}, [],
     ['127.0.0.1', '10.0.0.2', '10.0.0.3']),
    ({RANGE: 'SUBNET', 'ROS_LOCALHOST_ONLY': '1'}, ['127.0.0.1'], ['127.0.0.1']),
    ({RANGE: 'SUBNET', 'ROS_LOCALHOST_ONLY': '1', 'ROS_STATIC_PEERS': '10.0.0.2'},
     ['127.0.0.1'], ['127.0.0.1']),
])
def test_sockets_and_peers_follow_the_discovery_range(tmp_path, environment, sockets, peers):
    root, added = profile(tmp_path, **environment)
    assert texts(root, 'interfaceWhiteList/address') == sockets
    assert texts(root, 'initialPeersList/locator/udpv4/address') == peers
    # ROS adds shared memory where it limits the range itself.
    assert added.get(RANGE) == ('SYSTEM_DEFAULT' if peers else None)
    assert added.get('ROS_LOCALHOST_ONLY', '') == ''


def test_peers_of_the_command_line_are_reached_whatever_the_older_variable_says(
        tmp_path, monkeypatch):
    for name in (RANGE, 'ROS_STATIC_PEERS'):
        monkeypatch.setenv(name, '')
    monkeypatch.setenv('ROS_LOCALHOST_ONLY', '1')
    set_environment(Namespace(peers=['127.0.0.2'], domain_id=None))
    kept = {name: os.environ.get(name, '') for name in (
        RANGE, 'ROS_STATIC_PEERS', 'ROS_LOCALHOST_ONLY')}
    root, _ = profile(tmp_path, **kept)
    assert texts(root, 'initialPeersList/locator/udpv4/address') == ['127.0.0.1', '127.0.0.2']


def test_peer_without_an_address_is_named(tmp_path):
    environment = {RANGE: 'LOCALHOST', 'ROS_STATIC_PEERS': 'nobody.invalid'}
    with pytest.raises(ValueError, match=r'nobody\.invalid'):
        middleware_environment(environment, tmp_path, FAST_DDS)


@pytest.mark.parametrize(('environment', 'implementation'), [
    ({VARIABLES[0]: 'mine.xml', RANGE: 'LOCALHOST'}, FAST_DDS),
    ({RANGE: 'LOCALHOST'}, 'rmw_cyclonedds_cpp'),
])
def test_profile_of_the_user_and_other_middleware_stay(tmp_path, environment, implementation):
    assert middleware_environment(environment, tmp_path, implementation) == {}
    assert not list(tmp_path.iterdir())
