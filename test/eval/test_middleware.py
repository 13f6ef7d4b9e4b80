"""The middleware's profile: room for large frames, and never over one of the user's."""

import xml.etree.ElementTree as ElementTree

from lowsnr_eval.middleware import middleware_environment
from lowsnr_eval.middleware import PROFILE_FILE
import pytest

SPACE = '{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}'


def profile(folder, frame_bytes):
    """Return the profile that is written for frames of this size."""
    found = middleware_environment({'A': 'b'}, folder, frame_bytes)
    assert found == {
        'FASTRTPS_DEFAULT_PROFILES_FILE': str(folder / PROFILE_FILE),
        'FASTDDS_DEFAULT_PROFILES_FILE': str(folder / PROFILE_FILE)}
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


def test_profile_of_the_user_stays(tmp_path):
    given = {'FASTRTPS_DEFAULT_PROFILES_FILE': 'mine.xml'}
    assert middleware_environment(given, tmp_path, 2**22) == {}
    assert not list(tmp_path.iterdir())
