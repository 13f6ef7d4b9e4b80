"""Bags that are damaged, or none at all: used as far as they are whole, or named in one line."""

from pathlib import Path
import shutil

from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.recorded_run import inspect_bag
from lowsnr_bringup.bags.replaying import header_stamp
from lowsnr_bringup.bags.writer import BagWriter
from lowsnr_bringup.ros.frame_bag import FrameBag
import numpy as np
import pytest

SECOND = 1_000_000_000
FRAMES = 40
FILES = {'mcap': 'bag.mcap', 'sqlite3': 'bag.db3'}
TOPICS = ('/image_raw', '/ground_truth')


@pytest.fixture(scope='module', params=FILES)
def whole(request, tmp_path_factory):
    """Return a bag of 40 frames of 100 x 80 cells in several chunks, and its storage file."""
    folder = tmp_path_factory.mktemp(request.param) / 'bag'
    with FrameBag(folder, request.param) as bag:
        for k in range(1, FRAMES + 1):
            bag.add(np.zeros((100, 80)), k * SECOND, ())
            if k % 5 == 0:
                bag.sync()
    return folder, FILES[request.param]


def read(path):
    """Return the stamps [s] of the frames of a bag that can be read, and the notes."""
    with Bag(path) as bag:
        found = [bag.read(item).header.stamp.sec for item in bag.messages({'/image_raw'})]
        return found, bag.notes


def refusal(path):
    """Return the line with which a bag is refused."""
    with pytest.raises(ValueError, match=r'^\S') as caught:
        inspect_bag(path, *TOPICS)
    line = str(caught.value)
    assert '\n' not in line
    return line


@pytest.mark.parametrize('share', [0.3, 0.5, 0.8, 0.97])
def test_cut_off_bag_is_used_up_to_the_cut(whole, tmp_path, share):
    folder, name = whole
    copy = shutil.copytree(folder, tmp_path / 'bag')
    data = (folder / name).read_bytes()
    (copy / name).write_bytes(data[:int(share * len(data))])
    found, notes = read(copy)
    # A chunk holds five frames, and metadata stand before and after the messages.
    assert len(found) > share * FRAMES - 12
    assert found == list(range(1, len(found) + 1))
    assert str(copy / name) in notes[0]
    assert 'used up to there' in notes[0]
    assert inspect_bag(copy, *TOPICS).frames == len(found)
    assert inspect_bag(copy, *TOPICS).notes


def test_bag_with_a_damaged_middle_is_used_up_to_it(whole, tmp_path):
    folder, name = whole
    copy = shutil.copytree(folder, tmp_path / 'bag')
    data = bytearray((folder / name).read_bytes())
    middle = len(data) // 2
    data[middle:middle + 150_000] = b'\xff' * 150_000
    (copy / name).write_bytes(data)
    with Bag(copy) as bag:
        found = [header_stamp(item.data) for item in bag.messages({'/image_raw'})]
    assert found[:10] == [k * SECOND for k in range(1, 11)]
    assert len(found) < FRAMES
    assert 'used up to there' in bag.notes[-1]


def test_any_flipped_bytes_are_read_or_refused_by_name(whole, tmp_path, rng):
    folder, name = whole
    data = (folder / name).read_bytes()
    path = tmp_path / name
    for _ in range(60):
        spoilt = bytearray(data)
        for place in rng.integers(len(data), size=8):
            spoilt[place] = rng.integers(256)
        path.write_bytes(spoilt[:rng.integers(len(data) // 2, len(data))])
        lines = []
        try:
            lines = read(path)[1]
        except ValueError as error:
            lines = [str(error)]
        assert all(line.startswith(str(path)) and '\n' not in line for line in lines)


def test_missing_metadata_are_done_without(whole, tmp_path):
    folder, name = whole
    copy = shutil.copytree(folder, tmp_path / 'bag')
    (copy / 'metadata.yaml').unlink()
    found, notes = read(copy)
    assert len(found) == FRAMES
    assert notes == [f'{copy}/metadata.yaml: is missing; the files beside where it should be '
                     'are taken']
    assert len(read(copy / name)[0]) == FRAMES


def test_bag_that_is_none_is_named(whole, tmp_path):
    folder, name = whole
    assert refusal(tmp_path / 'no') == f'{tmp_path}/no: there is no such bag'
    assert 'has neither metadata.yaml nor storage' in refusal(tmp_path)
    (tmp_path / 'file').write_text('words')
    assert refusal(tmp_path / 'file').endswith('is neither MCAP nor SQLite')
    copy = shutil.copytree(folder, tmp_path / 'bag')
    (copy / name).write_bytes(b'')
    assert refusal(copy) == f'{copy / name}: is empty (zero bytes)'
    (copy / name).unlink()
    assert refusal(copy) == f'{copy / name}: is missing, though metadata.yaml names it'


@pytest.mark.parametrize('text', [
    '', '- 1', '[', 'rosbag2_bagfile_information: 3', 'rosbag2_bagfile_information: {}',
    'rosbag2_bagfile_information: {relative_file_paths: 7}', '\x00',
    '!!python/object:os.system x'])
def test_metadata_that_are_none_are_named(whole, tmp_path, text):
    copy = shutil.copytree(whole[0], tmp_path / 'bag')
    (copy / 'metadata.yaml').write_text(text)
    assert refusal(copy).startswith(f'{copy}/metadata.yaml: is not')


@pytest.mark.parametrize('path', ['../secret.db3', '/etc/passwd', '..', '', 'x/../../secret.db3'])
def test_paths_never_lead_out_of_the_bag(whole, tmp_path, path):
    folder, name = whole
    copy = shutil.copytree(folder, tmp_path / 'bag')
    (tmp_path / 'secret.db3').write_bytes((folder / name).read_bytes())
    metadata = copy / 'metadata.yaml'
    metadata.write_text(metadata.read_text().replace(f'- {name}', f"- '{path}'", 1))
    assert refusal(copy) == f"{metadata}: {path!r} leads out of the bag's folder"


def test_links_never_lead_out_of_the_bag(whole, tmp_path):
    folder, name = whole
    copy = shutil.copytree(folder, tmp_path / 'bag')
    (copy / name).rename(tmp_path / 'secret')
    (copy / name).symlink_to(tmp_path / 'secret')
    assert "leads out of the bag's folder" in refusal(copy)
    (copy / 'metadata.yaml').unlink()
    assert "leads out of the bag's folder" in refusal(copy)


def test_frames_of_changing_size_are_named(tmp_path):
    with FrameBag(tmp_path / 'bag') as bag:
        for k, shape in enumerate([(3, 4), (3, 4), (4, 4)], start=1):
            bag.add(np.zeros(shape), k * SECOND, None)
    assert refusal(tmp_path / 'bag') == (
        f'{tmp_path}/bag: /image_raw: frame 3 has 4 x 4 pixels after frames of 4 x 3')


@pytest.mark.parametrize('last', [1, 2])
def test_stamps_that_do_not_rise_are_named(tmp_path, last):
    with FrameBag(tmp_path / 'bag') as bag:
        for k, stamp in enumerate([1, 2, last]):
            bag.add(np.full((3, 4), float(k)), stamp * SECOND, None)
    # A reader that has an index sorts by log time, which is the stamp here.
    line = refusal(tmp_path / 'bag')
    assert 'which is not after' in line


def test_bag_without_frames_is_named(tmp_path):
    with BagWriter(tmp_path / 'bag') as bag:
        bag.write(bag.add_topic('/image_raw', 'std_msgs/msg/Header'), bytes(20), 1, 1)
        bag.add_topic('/camera', 'sensor_msgs/msg/Image')
    assert refusal(tmp_path / 'bag') == (
        f'{tmp_path}/bag: /image_raw is of type std_msgs/msg/Header, not sensor_msgs/msg/Image')
    with pytest.raises(ValueError, match='/camera: no frames'):
        inspect_bag(tmp_path / 'bag', '/camera', '/ground_truth')
    with pytest.raises(
            ValueError, match=r'has no topic /frames of .*; --frames-topic can be /camera'):
        inspect_bag(tmp_path / 'bag', '/frames', '/ground_truth')


@pytest.mark.parametrize('storage', FILES)
def test_unknown_message_type_is_named(tmp_path, storage):
    folder = tmp_path / 'bag'
    with FrameBag(folder, storage) as bag:
        bag.add(np.zeros((3, 4)), SECOND, None)
    for path in folder.iterdir():
        path.write_bytes(path.read_bytes().replace(
            b'sensor_msgs/msg/Image', b'no_such_msgs/msg/Imag'))
    assert '/image_raw is of type no_such_msgs/msg/Imag, not sensor_msgs' in refusal(folder)


def test_messages_that_do_not_fit_their_type_are_named(tmp_path):
    with BagWriter(Path(tmp_path / 'bag')) as bag:
        bag.write(bag.add_topic('/image_raw', 'sensor_msgs/msg/Image'), b'\0\1\0\0\1', 1, 1)
    assert '/image_raw: a message of 5 bytes is no sensor_msgs/msg/Image' in refusal(
        tmp_path / 'bag')
