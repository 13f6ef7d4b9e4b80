"""Bags that are written here, read by other readers; and what is left when the writer ends."""

import os
from pathlib import Path
import resource
import signal
import subprocess
import sys

from lowsnr_bringup.bags.definitions import type_definition
from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.writer import BagWriter
from lowsnr_bringup.ros.frame_bag import FrameBag
from lowsnr_common.core.records import Truth
from mcap.reader import make_reader
from mcap_ros2.reader import read_ros2_messages
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_typestore
from rosbags.typesys import Stores

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
    # This reader computes each hash anew from the definition and refuses one that differs.
    with AnyReader([write(tmp_path / 'bag', storage)]) as reader:
        hashes = {item.msgtype: item.digest for item in reader.connections}
        messages = [reader.deserialize(data, item.msgtype)
                    for item, _, data in reader.messages()]
    assert hashes['vision_msgs/msg/Detection2DArray'] == DETECTIONS_HASH
    assert len(messages) == 22


def test_type_that_nobody_defines_is_named():
    with pytest.raises(ValueError, match='no_msgs/msg/Nothing: no installed package'):
        type_definition('no_msgs/msg/Nothing')


@pytest.mark.parametrize('name', [
    '', 'Image', 'sensor_msgs/Image', 'sensor_msgs/msg/../msg/Image',
    '../share/sensor_msgs/msg/Image', 'sensor_msgs/msg/Image/', '/sensor_msgs/msg/Image',
    'sensor_msgs/msg/Image\n'])
def test_type_name_never_leads_elsewhere(name):
    with pytest.raises(ValueError, match='is no message type'):
        type_definition(name)


@pytest.mark.parametrize(('dtype', 'encoding'), [
    (np.uint8, 'mono8'), (np.uint16, 'mono16'), (np.float64, '32FC1')])
def test_frames_keep_their_depth(tmp_path, dtype, encoding):
    with Bag(write(tmp_path / 'bag', dtype=dtype)) as bag:
        image = bag.read(next(bag.messages({'/image_raw'})))
    assert image.encoding == encoding
    kind = np.float32 if dtype is np.float64 else dtype
    assert image.data.view(kind).tolist() == frame(1).ravel().tolist()


def test_frames_of_another_depth_are_refused(tmp_path):
    with FrameBag(tmp_path / 'bag') as bag, pytest.raises(ValueError, match='frames of int64'):
        bag.add(np.zeros((2, 2), dtype=np.int64), 1, None)


@pytest.mark.parametrize('make', ['mkdir', 'touch'])
def test_nothing_is_overwritten(tmp_path, make):
    getattr(tmp_path / 'bag', make)()
    with pytest.raises(ValueError, match='bag: exists, and nothing is overwritten'):
        BagWriter(tmp_path / 'bag')


def test_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / 'file').touch()
    with pytest.raises(ValueError, match='file/bag: the bag cannot be written: '):
        BagWriter(tmp_path / 'file' / 'bag')


WRITER = """
import sys
from pathlib import Path
from lowsnr_bringup.bags.writer import BagWriter
bag = BagWriter(Path(sys.argv[1]), sys.argv[2], {'key': 'text'})
topic = bag.add_topic('/clock', 'rosgraph_msgs/msg/Clock')
number = 0
while True:
    number += 1
    bag.write(topic, bytes(8) + number.to_bytes(4, 'little'), number, number)
    if number % 10_000 == 0:
        bag.sync()
        print(number, flush=True)
"""


def start_writer(folder, storage, **options):
    """Start a process that writes for ever, and says how many messages are safe."""
    return subprocess.Popen(
        [sys.executable, '-c', WRITER, str(folder), storage], stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, env=os.environ | {'PYTHONPATH': os.pathsep.join(
            path for path in sys.path if path)}, **options)


def numbers(bag):
    return [int.from_bytes(item.data[8:12], 'little') for item in bag.messages({'/clock'})]


@pytest.mark.parametrize('storage', STORAGES)
def test_bag_is_whole_up_to_the_last_sync_after_sigkill(tmp_path, storage):
    folder = tmp_path / 'bag'
    with start_writer(folder, storage) as process:
        safe = [int(process.stdout.readline()) for _ in range(5)][-1]
        process.send_signal(signal.SIGKILL)
    with Bag(folder) as bag:
        found = numbers(bag)
        assert bag.custom == {'key': 'text'}
    assert len(found) >= safe
    assert found == list(range(1, len(found) + 1))


@pytest.mark.parametrize('storage', STORAGES)
def test_bag_is_whole_up_to_the_last_sync_after_a_full_disk(tmp_path, storage):
    folder, most = tmp_path / 'bag', 3 * 2**20
    with start_writer(folder, storage, preexec_fn=lambda: resource.setrlimit(
            resource.RLIMIT_FSIZE, (most, most))) as process:
        out, err = process.communicate(timeout=60.0)
    assert process.returncode == 1
    assert 'File too large' in err or 'disk I/O error' in err or 'full' in err
    safe = int(out.split()[-1])
    with Bag(folder) as bag:
        found = numbers(bag)
    assert len(found) >= safe >= 10_000
    assert found == list(range(1, len(found) + 1))


def test_bag_of_another_writer_is_read(tmp_path):
    from mcap_ros2.writer import Writer
    path = tmp_path / 'other.mcap'
    with path.open('wb') as file, Writer(file) as writer:
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
    from rosbags.rosbag2 import CompressionFormat
    from rosbags.rosbag2 import CompressionMode
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer
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
    folder = write(tmp_path / 'bag', frames=3)
    with FrameBag(tmp_path / 'more') as bag:
        for k in (4, 5):
            bag.add(frame(k), k * SECOND, None)
    Path(tmp_path / 'more' / 'more.mcap').rename(folder / 'bag_1.mcap')
    metadata = folder / 'metadata.yaml'
    first = 'relative_file_paths:\n  - bag.mcap'
    metadata.write_text(metadata.read_text().replace(first, f'{first}\n  - bag_1.mcap'))
    with Bag(folder) as bag:
        assert stamps(bag, '/image_raw') == [1, 2, 3, 4, 5]
