"""The middleware's profile: who is let in, room for large frames, never over the user's own."""

import xml.etree.ElementTree as ElementTree

from lowsnr_bringup.run.middleware import middleware_environment
from lowsnr_bringup.run.middleware import PROFILE_FILE
import pytest

SPACE = '{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}'


def profile(folder, frame_bytes, **environment):
    """Return the profile that is written for frames of this size."""
    found = middleware_environment(environment, folder, frame_bytes)
    assert found == {
        'FASTRTPS_DEFAULT_PROFILES_FILE': str(folder / PROFILE_FILE),
        'FASTDDS_DEFAULT_PROFILES_FILE': str(folder / PROFILE_FILE),
        'RMW_FASTRTPS_USE_QOS_FROM_XML': '1'}
    return ElementTree.parse(folder / PROFILE_FILE).getroot()


@pytest.mark.parametrize('frame_bytes', [0, 4 * 20 * 20, 4 * 128 * 128])
def test_small_frames_leave_the_transports_as_they_are(tmp_path, frame_bytes):
    root = profile(tmp_path, frame_bytes)
    assert root.find(f'{SPACE}transport_descriptors') is None
    assert root.find(f'.//{SPACE}useBuiltinTransports') is None
    assert root.find(f'.//{SPACE}heartbeatPeriod') is not None


@pytest.mark.parametrize('side', [256, 1024, 16384])
def test_segment_holds_frames(tmp_path, side):
    root = profile(tmp_path, 4 * side * side)
    message, segment = (
        int(next(root.iter(f'{SPACE}{name}')).text) for name in ('maxMessageSize', 'segment_size'))
    assert 4 * side * side < message
    assert 2 * message <= segment < 2**32


@pytest.mark.parametrize('frame_bytes', [0, 2**22])
@pytest.mark.parametrize(('environment', 'only'), [
    ({}, []),
    ({'ROS_AUTOMATIC_DISCOVERY_RANGE': ''}, []),
    ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'}, []),
    ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SYSTEM_DEFAULT'}, []),
    ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}, ['127.0.0.1']),
    ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'ROS_STATIC_PEERS': '10.0.0.2'}, []),
    ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET', 'ROS_LOCALHOST_ONLY': '1'}, ['127.0.0.1']),
])
def test_sockets_stay_on_this_host_with_discovery(tmp_path, environment, only, frame_bytes):
    root = profile(tmp_path, frame_bytes, **environment)
    assert [item.text for item in root.iterfind(f'.//{SPACE}address')] == only
    kinds = {item.text for item in root.iterfind(f'.//{SPACE}type')}
    assert kinds == ({'SHM', 'UDPv4'} if only or frame_bytes else set())


def test_profile_of_the_user_stays(tmp_path):
    given = {'FASTRTPS_DEFAULT_PROFILES_FILE': 'mine.xml'}
    assert middleware_environment(given, tmp_path, 2**22) == {}
    assert not list(tmp_path.iterdir())
