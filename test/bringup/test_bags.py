# SPDX-License-Identifier: Apache-2.0
"""Bags that are written here, read by our reader and by others."""

import itertools
import re

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.type_definitions import type_definition
from lowsnr_bringup.bags.writer import BagWriter
from lowsnr_bringup.ros.frame_bag import FrameBag
from lowsnr_common.core.records import Truth
from mcap.reader import make_reader
from mcap_ros2.reader import read_ros2_messages
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability
from rosbags.interfaces import QosReliability
import yaml

STORAGES = ('mcap', 'sqlite3')
SECOND = 1_000_000_000
# The hash that every ROS 2 Jazzy has for this type.
DETECTIONS_HASH = 'RIHS01_214274120007f4a683866481336b70310268cfa107aebe9d594a6acf75bda968'
STATE = np.array([3.0, 0.5, 2.0, -0.25])


def frame(k, shape=(5, 7), dtype=np.float32):
    return np.arange(shape[0] * shape[1]).reshape(shape).astype(dtype) + dtype(k)


def write(folder, storage='mcap', frames=6, dtype=np.float32, custom=None):
    """Write frames 1 to ``frames``, the object there from the third on."""
    with FrameBag(folder, storage, custom) as bag:
        for k in range(1, frames + 1):
            bag.add(frame(k, dtype=dtype), k * SECOND,
                    [Truth('a', STATE)] if k > 2 else ())
    return folder


def stamps(bag, topic):
    """Return the stamps [s] of what a bag reads of a topic."""
    return [bag.read(message).header.stamp.sec for message in bag.messages({topic})]


@pytest.mark.parametrize('storage', STORAGES)
def test_what_is_written_is_read(tmp_path, storage):
    with Bag(write(tmp_path / 'bag', storage, custom={'key': 'text'})) as bag:
        assert bag.custom == {'key': 'text'}
        assert bag.notes == []
        assert bag.topics == {
            '/clock': 'rosgraph_msgs/msg/Clock', '/image_raw': 'sensor_msgs/msg/Image',
            '/ground_truth': 'vision_msgs/msg/Detection2DArray',
            '/ground_truth/odometry': 'nav_msgs/msg/Odometry'}
        assert stamps(bag, '/image_raw') == stamps(bag, '/ground_truth') == [1, 2, 3, 4, 5, 6]
        assert stamps(bag, '/ground_truth/odometry') == [3, 4, 5, 6]


def test_second_reader_finds_topics_types_times_and_values(tmp_path):
    found = list(read_ros2_messages(write(tmp_path / 'bag') / 'bag.mcap'))
    assert len(found) == 6 + 6 + 4 + 6
    images = [item for item in found if item.channel.topic == '/image_raw']
    for k, item in enumerate(images, start=1):
        assert (item.log_time_ns, item.publish_time_ns) == (k * SECOND, k * SECOND)
        assert np.frombuffer(item.ros_msg.data, '<f4').tolist() == frame(k).ravel().tolist()
        assert (item.ros_msg.height, item.ros_msg.width) == (5, 7)
    last = [item for item in found if item.channel.topic == '/ground_truth'][-1]
    assert last.schema.name == 'vision_msgs/msg/Detection2DArray'
    assert last.channel.metadata['topic_type_hash'] == DETECTIONS_HASH
    centre = last.ros_msg.detections[0].bbox.center.position
    assert (centre.x, centre.y) == (3.0, 2.0)


def test_log_and_publish_times_are_kept_apart(tmp_path):
    with BagWriter(tmp_path / 'bag') as bag:
        bag.write(bag.add_topic('/clock', 'rosgraph_msgs/msg/Clock'), bytes(12), 20, 10)
    with (tmp_path / 'bag' / 'bag.mcap').open('rb') as file:
        (_, _, message), = make_reader(file).iter_messages()
    assert (message.log_time, message.publish_time) == (20, 10)


@pytest.mark.parametrize('storage', STORAGES)
def test_definitions_hash_to_what_dds_advertises(tmp_path, storage):
    # This reader computes each hash from the definition and rejects one that differs.
    with AnyReader([write(tmp_path / 'bag', storage)]) as reader:
        hashes = {item.msgtype: item.digest for item in reader.connections}
        messages = [reader.deserialize(data, item.msgtype)
                    for item, _, data in reader.messages()]
    assert hashes['vision_msgs/msg/Detection2DArray'] == DETECTIONS_HASH
    assert len(messages) == 22


def test_undefined_type_is_named():
    with pytest.raises(ValueError, match='no_msgs/msg/Nothing'):
        type_definition('no_msgs/msg/Nothing')


@pytest.mark.parametrize('name', [
    '', 'Image', 'sensor_msgs/Image', 'sensor_msgs/msg/../msg/Image',
    '../share/sensor_msgs/msg/Image', 'sensor_msgs/msg/Image/', '/sensor_msgs/msg/Image',
    'sensor_msgs/msg/Image\n'])
def test_type_name_never_leads_elsewhere(name):
    with pytest.raises(ValueError, match=f'^{re.escape(repr(name))}'):
        type_definition(name)


@pytest.mark.parametrize(('dtype', 'encoding'), [
    (np.uint8, 'mono8'), (np.uint16, 'mono16'), (np.float64, '32FC1')])
def test_frames_keep_their_depth(tmp_path, dtype, encoding):
    with Bag(write(tmp_path / 'bag', dtype=dtype)) as bag:
        image = bag.read(next(bag.messages({'/image_raw'})))
    assert image.encoding == encoding
    kind = np.float32 if dtype is np.float64 else dtype
    assert image.data.view(kind).tolist() == frame(1).ravel().tolist()


def test_frames_of_another_depth_are_rejected(tmp_path):
    with FrameBag(tmp_path / 'bag') as bag, pytest.raises(ValueError, match='int64'):
        bag.add(np.zeros((2, 2), dtype=np.int64), 1, None)


@pytest.mark.parametrize('make', ['mkdir', 'touch'])
def test_nothing_is_overwritten(tmp_path, make):
    getattr(tmp_path / 'bag', make)()
    with pytest.raises(UnusableFile) as caught:
        BagWriter(tmp_path / 'bag')
    assert (caught.value.path, caught.value.reason) == (tmp_path / 'bag', 'exists')


def test_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / 'file').touch()
    with pytest.raises(UnusableFile) as caught:
        BagWriter(tmp_path / 'file' / 'bag')
    assert (caught.value.path, caught.value.reason) == (
        tmp_path / 'file' / 'bag', 'not writable')


QOS = {
    'history': 'keep_last', 'depth': 7, 'reliability': 'best_effort',
    'durability': 'transient_local', 'deadline': {'sec': 1, 'nsec': 2},
    'lifespan': {'sec': 3, 'nsec': 4}, 'liveliness': 'automatic',
    'liveliness_lease_duration': {'sec': 5, 'nsec': 6},
    'avoid_ros_namespace_conventions': False}


@pytest.mark.parametrize('storage', STORAGES)
def test_quality_of_service_is_kept_in_metadata_and_storage(tmp_path, storage):
    with BagWriter(tmp_path / 'bag', storage) as bag:
        bag.write(bag.add_topic('/clock', 'rosgraph_msgs/msg/Clock', [QOS]), bytes(12), 1, 1)
    for path in (tmp_path / 'bag', next((tmp_path / 'bag').glob('bag.*'))):
        with AnyReader([path]) as reader:
            (found,), = (item.ext.offered_qos_profiles for item in reader.connections)
        assert (found.reliability, found.durability, found.depth) == (
            QosReliability.BEST_EFFORT, QosDurability.TRANSIENT_LOCAL, 7)
        assert tuple(found.lifespan) == (3, 4)


@pytest.mark.parametrize('storage', STORAGES)
def test_metadata_are_those_of_rosbag2_version_9(tmp_path, storage):
    information = yaml.safe_load((write(tmp_path / 'bag', storage, custom={'key': 'a: b\n'}) /
                                  'metadata.yaml').read_text())['rosbag2_bagfile_information']
    assert information['version'] == 9
    assert information['storage_identifier'] == storage
    assert information['message_count'] == 22
    assert information['starting_time'] == {'nanoseconds_since_epoch': SECOND}
    assert information['duration'] == {'nanoseconds': 5 * SECOND}
    assert information['custom_data'] == {'key': 'a: b\n'}
    assert information['files'][0]['path'] == information['relative_file_paths'][0]
    topics = {item['topic_metadata']['name']: (
        item['message_count'], item['topic_metadata']['type_description_hash'])
        for item in information['topics_with_message_count']}
    assert topics['/ground_truth'] == (6, DETECTIONS_HASH)


@pytest.mark.parametrize('storage', STORAGES)
def test_messages_come_in_the_order_of_their_log_times(tmp_path, storage, rng):
    times = rng.permutation(60)
    with BagWriter(tmp_path / 'bag', storage) as bag:
        topics = [bag.add_topic(name, 'rosgraph_msgs/msg/Clock') for name in ('/a', '/b')]
        for topic, (k, time) in zip(itertools.cycle(topics), enumerate(times)):
            bag.write(topic, bytes(8) + int(time).to_bytes(4, 'little'), int(time), 0)
            if k % 7 == 0:  # chunks overlap
                bag.sync()
    with Bag(tmp_path / 'bag') as bag:
        for names in ({'/a', '/b'}, {'/b'}):
            found = [(item.logged_ns, item.data[8]) for item in bag.messages(names)]
            assert found == sorted(found)
            assert len(found) == 30 * len(names)
            assert all(logged_ns == value for logged_ns, value in found)


def test_bag_that_is_being_written_names_its_topics(tmp_path):
    bag = BagWriter(tmp_path / 'bag')
    bag.write(bag.add_topic('/clock', 'rosgraph_msgs/msg/Clock'), bytes(12), 1, 1)
    bag.sync()
    bag.add_topic('/image_raw', 'sensor_msgs/msg/Image')
    bag.sync()
    assert sorted(path.name for path in bag.folder.iterdir()) == ['bag.mcap', 'metadata.yaml']
    text = (bag.folder / 'metadata.yaml').read_text()
    topics = yaml.safe_load(text)['rosbag2_bagfile_information']['topics_with_message_count']
    assert [item['topic_metadata']['name'] for item in topics] == ['/clock', '/image_raw']
    bag.close()


def test_removed_bag_is_noticed(tmp_path):
    bag = BagWriter(tmp_path / 'bag')
    for path in bag.folder.iterdir():
        path.unlink()
    with pytest.raises(FileNotFoundError):
        bag.sync()
    bag.abort()
