"""The profile of the middleware: its transport, its reach, and that a user's own comes first."""

import xml.etree.ElementTree as ElementTree

from lowsnr_bringup.run.middleware import middleware_environment
from lowsnr_bringup.run.middleware import PROFILE_FILE
import pytest

SPACE = '{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}'


def profile(folder, **environment):
    """Return the profile that is written in an environment."""
    found = middleware_environment(environment, folder)
    assert found == {
        'FASTRTPS_DEFAULT_PROFILES_FILE': str(folder / PROFILE_FILE),
        'FASTDDS_DEFAULT_PROFILES_FILE': str(folder / PROFILE_FILE),
        'RMW_FASTRTPS_USE_QOS_FROM_XML': '1'}
    return ElementTree.parse(folder / PROFILE_FILE).getroot()


def test_udp_is_the_only_transport(tmp_path):
    root = profile(tmp_path)
    assert [item.text for item in root.iter(f'{SPACE}type')] == ['UDPv4']
    assert [item.text for item in root.iter(f'{SPACE}useBuiltinTransports')] == ['false']
    used = [item.text for item in root.iterfind(f'.//{SPACE}userTransports/{SPACE}transport_id')]
    made = [item.text for item in root.iterfind(
        f'.//{SPACE}transport_descriptor/{SPACE}transport_id')]
    assert used == made
    assert len(made) == 1


@pytest.mark.parametrize(('environment', 'only'), [
    ({}, []),
    ({'ROS_AUTOMATIC_DISCOVERY_RANGE': ''}, []),
    ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'}, []),
    ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SYSTEM_DEFAULT'}, []),
    ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}, ['127.0.0.1']),
    ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'ROS_STATIC_PEERS': '10.0.0.2'}, []),
    ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET', 'ROS_LOCALHOST_ONLY': '1'}, ['127.0.0.1']),
])
def test_sockets_stay_on_this_host_with_discovery(tmp_path, environment, only):
    root = profile(tmp_path, **environment)
    assert [item.text for item in root.iterfind(f'.//{SPACE}address')] == only


def test_profile_of_the_user_stays(tmp_path):
    given = {'FASTRTPS_DEFAULT_PROFILES_FILE': 'mine.xml'}
    assert middleware_environment(given, tmp_path) == {}
    assert not list(tmp_path.iterdir())
