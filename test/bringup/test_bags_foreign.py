# SPDX-License-Identifier: Apache-2.0
"""Bags of other writers: without index, compressed, split."""

from pathlib import Path

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.type_definitions import type_definition
from lowsnr_bringup.ros.frame_bag import FrameBag
from mcap.writer import CompressionType
from mcap.writer import IndexType
from mcap.writer import Writer as McapWriter
from mcap_ros2.writer import Writer as McapRos2Writer
import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat
from rosbags.rosbag2 import CompressionMode
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer
from rosbags.typesys import get_typestore
from rosbags.typesys import Stores

SECOND = 1_000_000_000


def stamps(bag, topic):
    """Return the stamps [s] of the messages of a topic."""
    return [bag.read(message).header.stamp.sec for message in bag.messages({topic})]


def test_bag_of_another_writer_is_read(tmp_path):
    path = tmp_path / 'other.mcap'
    with path.open('wb') as file, McapRos2Writer(file) as writer:
        schema = writer.register_msgdef(
            'sensor_msgs/msg/Image', type_definition('sensor_msgs/msg/Image').text)
        for k in (1, 2, 3):
            writer.write_message('/camera', schema, {
                'header': {'stamp': {'sec': k, 'nanosec': 0}, 'frame_id': 'lens'}, 'height': 1,
                'width': 2, 'encoding': 'mono8', 'step': 2, 'data': bytes([k, k])}, k, k)
    with Bag(path) as bag:
        assert bag.topics == {'/camera': 'sensor_msgs/msg/Image'}
        assert stamps(bag, '/camera') == [1, 2, 3]


@pytest.mark.parametrize('mode', ['FILE', 'MESSAGE', 'STORAGE'])
def test_compressed_bag_with_other_topics_is_read(tmp_path, mode):
    store = get_typestore(Stores.ROS2_JAZZY)
    text, image = 'std_msgs/msg/String', 'sensor_msgs/msg/Image'
    writer = Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        chatter = writer.add_connection('/chatter', text, typestore=store)
        camera = writer.add_connection('/camera', image, typestore=store)
        header, stamp = (store.types[name] for name in (
            'std_msgs/msg/Header', 'builtin_interfaces/msg/Time'))
        for k in (1, 2, 3):
            writer.write(chatter, k, store.serialize_cdr(store.types[text]('x'), text))
            writer.write(camera, k, store.serialize_cdr(store.types[image](
                header(stamp(k, 0), ''), 1, 1, 'mono8', 0, 1, np.array([k], np.uint8)), image))
    with Bag(tmp_path / 'bag') as bag:
        assert bag.topics == {'/chatter': text, '/camera': image}
        assert stamps(bag, '/camera') == [1, 2, 3]
        assert bag.notes == []


def test_split_bag_is_read_in_order(tmp_path):
    folder = tmp_path / 'bag'
    for name, numbers in (('bag', (1, 2, 3)), ('more', (4, 5))):
        with FrameBag(tmp_path / name) as bag:
            for k in numbers:
                bag.add(np.zeros((2, 3)), k * SECOND, None)
    Path(tmp_path / 'more' / 'more.mcap').rename(folder / 'bag_1.mcap')
    metadata = folder / 'metadata.yaml'
    first = 'relative_file_paths:\n  - bag.mcap'
    metadata.write_text(metadata.read_text().replace(first, f'{first}\n  - bag_1.mcap'))
    with Bag(folder) as bag:
        assert stamps(bag, '/image_raw') == [1, 2, 3, 4, 5]


def header_message(k):
    """Return a serialized ``std_msgs/msg/Header`` with stamp k [s]."""
    return b'\0\1\0\0' + k.to_bytes(4, 'little') + bytes(4) + b'\1\0\0\0\0'


@pytest.mark.parametrize('options', [
    {'use_chunking': False}, {'index_types': IndexType.NONE}, {'index_types': IndexType.CHUNK},
    {'repeat_channels': False, 'repeat_schemas': False}, {'compression': CompressionType.LZ4},
    {'compression': CompressionType.ZSTD}, {'enable_crcs': False}, {'use_statistics': False},
    {'chunk_size': 40}], ids=str)
def test_any_layout_of_mcap_is_read(tmp_path, options):
    path = tmp_path / 'other.mcap'
    with path.open('wb') as file:
        writer = McapWriter(file, **options)
        writer.start('ros2')
        schema = writer.register_schema('std_msgs/msg/Header', 'ros2msg', b'')
        channel = writer.register_channel('/head', 'cdr', schema)
        for k in range(1, 9):
            writer.add_message(channel, k, header_message(k), k)
        writer.finish()
    with Bag(path) as bag:
        assert bag.notes == []
        assert bag.topics == {'/head': 'std_msgs/msg/Header'}
        assert [bag.read(item).stamp.sec for item in bag.messages({'/head'})] == [*range(1, 9)]
        assert bag.notes == []


def test_other_definition_of_a_type_is_rejected(tmp_path):
    path = tmp_path / 'other.mcap'
    with path.open('wb') as file:
        writer = McapWriter(file)
        writer.start('ros2')
        schema = writer.register_schema('std_msgs/msg/Header', 'ros2msg', b'')
        channel = writer.register_channel(
            '/head', 'cdr', schema, {'topic_type_hash': f'RIHS01_{0:064}'})
        writer.add_message(channel, 1, header_message(1), 1)
        writer.finish()
    with Bag(path) as bag, pytest.raises(UnusableFile) as caught:
        bag.read(next(bag.messages({'/head'})))
    assert (caught.value.path, caught.value.reason) == (path, 'other type')
