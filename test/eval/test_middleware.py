"""The middleware's profile: for large frames only, and never over one of the user's."""

import xml.etree.ElementTree as ElementTree

from lowsnr_eval.middleware import node_environment
from lowsnr_eval.middleware import PROFILE_FILE
import pytest

SPACE = '{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}'


@pytest.mark.parametrize('frame_bytes', [0, 4 * 20 * 20, 4 * 128 * 128])
def test_small_frames_need_no_profile(tmp_path, frame_bytes):
    assert node_environment({'A': 'b'}, tmp_path, frame_bytes) == {'A': 'b'}
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize('side', [256, 1024, 16384])
def test_segment_holds_frames(tmp_path, side):
    found = node_environment({}, tmp_path, 4 * side * side)
    assert set(found.values()) == {str(tmp_path / PROFILE_FILE)}
    root = ElementTree.parse(tmp_path / PROFILE_FILE).getroot()
    message, segment = (
        int(next(root.iter(f'{SPACE}{name}')).text) for name in ('maxMessageSize', 'segment_size'))
    assert 4 * side * side < message
    assert 2 * message <= segment < 2**32


def test_profile_of_the_user_stays(tmp_path):
    given = {'FASTRTPS_DEFAULT_PROFILES_FILE': 'mine.xml'}
    assert node_environment(given, tmp_path, 2**22) == given
    assert not list(tmp_path.iterdir())
