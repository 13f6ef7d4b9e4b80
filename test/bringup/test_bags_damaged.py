# SPDX-License-Identifier: Apache-2.0
"""Damaged bags are read up to the damage; files that are no bag are rejected by name."""

from pathlib import Path
import re
import shutil

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.recorded_run import inspect_bag
from lowsnr_bringup.bags.replay import header_stamp
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


def rejection(path, frames_topic='/image_raw'):
    """Return the file that is named, the reason, and the sentence with which a bag is rejected."""
    with pytest.raises(UnusableFile) as caught:
        inspect_bag(path, frames_topic, '/ground_truth')
    error = caught.value
    assert str(error).startswith(f'{error.path}: ')
    assert str(error).isprintable()
    return error.path, error.reason, str(error).removeprefix(f'{error.path}: ')


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
    assert notes[0].startswith(f'{copy / name}: ')
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
    assert bag.notes[-1].startswith(f'{copy / name}: ')


def test_a_flipped_byte_in_a_message_is_noticed(tmp_path):
    with FrameBag(tmp_path / 'bag') as bag:
        for k in (1, 2, 3):
            bag.add(np.full((10, 8), 7.5), k * SECOND, ())
            bag.sync()
    file = tmp_path / 'bag' / 'bag.mcap'
    data = bytearray(file.read_bytes())
    pixel = np.float32(7.5).tobytes() * 80
    data[data.index(pixel, data.index(pixel) + 320)] ^= 1  # of the second frame
    file.write_bytes(data)
    found, notes = read(file)
    assert found == [1]
    assert len(notes) == 1


def test_bytes_flipped_anywhere_never_raise_another_error(whole, tmp_path, rng):
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


def test_bag_without_metadata_is_read(whole, tmp_path):
    folder, name = whole
    copy = shutil.copytree(folder, tmp_path / 'bag')
    (copy / 'metadata.yaml').unlink()
    found, notes = read(copy)
    assert len(found) == FRAMES
    assert len(notes) == 1
    assert notes[0].startswith(f'{copy}/metadata.yaml: ')
    assert len(read(copy / name)[0]) == FRAMES


def test_what_is_not_a_bag_is_named(whole, tmp_path):
    folder, name = whole
    assert rejection(tmp_path / 'no')[:2] == (tmp_path / 'no', 'missing')
    assert rejection(tmp_path)[:2] == (tmp_path, 'not a bag')
    (tmp_path / 'file').write_text('words')
    assert rejection(tmp_path / 'file')[:2] == (tmp_path / 'file', 'not a bag')
    copy = shutil.copytree(folder, tmp_path / 'bag')
    (copy / name).write_bytes(b'')
    assert rejection(copy)[:2] == (copy / name, 'empty')
    (copy / name).unlink()
    assert rejection(copy)[:2] == (copy / name, 'missing')


@pytest.mark.parametrize('text', [
    '', '- 1', '[', 'rosbag2_bagfile_information: 3', 'rosbag2_bagfile_information: {}',
    'rosbag2_bagfile_information: {relative_file_paths: 7}', '\x00',
    '!!python/object:os.system x'])
def test_bad_metadata_are_named(whole, tmp_path, text):
    copy = shutil.copytree(whole[0], tmp_path / 'bag')
    (copy / 'metadata.yaml').write_text(text)
    assert rejection(copy)[:2] == (copy / 'metadata.yaml', 'bad metadata')


@pytest.mark.parametrize('path', ['../secret.db3', '/etc/passwd', '..', '', 'x/../../secret.db3'])
def test_paths_never_lead_out_of_the_bag(whole, tmp_path, path):
    folder, name = whole
    copy = shutil.copytree(folder, tmp_path / 'bag')
    (tmp_path / 'secret.db3').write_bytes((folder / name).read_bytes())
    metadata = copy / 'metadata.yaml'
    metadata.write_text(metadata.read_text().replace(f'- {name}', f"- '{path}'", 1))
    assert rejection(copy)[:2] == (metadata, 'outside the folder')
    assert repr(path) in rejection(copy)[2]


def test_links_never_lead_out_of_the_bag(whole, tmp_path):
    folder, name = whole
    copy = shutil.copytree(folder, tmp_path / 'bag')
    (copy / name).rename(tmp_path / 'secret')
    (copy / name).symlink_to(tmp_path / 'secret')
    assert rejection(copy)[1] == 'outside the folder'
    (copy / 'metadata.yaml').unlink()
    assert rejection(copy)[1] == 'outside the folder'


def test_frames_of_changing_size_are_named(tmp_path):
    with FrameBag(tmp_path / 'bag') as bag:
        for k, shape in enumerate([(3, 4), (3, 4), (4, 4)], start=1):
            bag.add(np.zeros(shape), k * SECOND, None)
    _, reason, sentence = rejection(tmp_path / 'bag')
    assert reason == 'size'
    assert {'/image_raw:', 'frame 3', '4 x 4', '4 x 3'} <= set(
        re.findall(r'/image_raw:|frame \d|\d x \d', sentence))


def test_bag_without_frames_is_named(tmp_path):
    with BagWriter(tmp_path / 'bag') as bag:
        bag.write(bag.add_topic('/image_raw', 'std_msgs/msg/Header'), bytes(20), 1, 1)
        bag.add_topic('/camera', 'sensor_msgs/msg/Image')
    _, reason, sentence = rejection(tmp_path / 'bag')
    assert reason == 'type'
    assert {'/image_raw', 'std_msgs/msg/Header'} <= set(re.split('[ ,;:]', sentence))
    assert rejection(tmp_path / 'bag', '/camera')[1] == 'no frames'
    _, reason, sentence = rejection(tmp_path / 'bag', '/frames')
    assert reason == 'no topic'
    assert {'/frames', '--frames-topic', '/camera'} <= set(sentence.split())


@pytest.mark.parametrize('storage', FILES)
def test_unknown_message_type_is_named(tmp_path, storage):
    folder = tmp_path / 'bag'
    with FrameBag(folder, storage) as bag:
        bag.add(np.zeros((3, 4)), SECOND, None)
    for path in folder.iterdir():
        path.write_bytes(path.read_bytes().replace(
            b'sensor_msgs/msg/Image', b'no_such_msgs/msg/Imag'))
    _, reason, sentence = rejection(folder)
    assert reason == 'type'
    assert 'no_such_msgs/msg/Imag' in sentence


def test_messages_that_do_not_fit_their_type_are_named(tmp_path):
    with BagWriter(Path(tmp_path / 'bag')) as bag:
        bag.write(bag.add_topic('/image_raw', 'sensor_msgs/msg/Image'), b'\0\1\0\0\1', 1, 1)
    _, reason, sentence = rejection(tmp_path / 'bag')
    assert reason == 'bad message'
    assert sentence.startswith('/image_raw: ')
