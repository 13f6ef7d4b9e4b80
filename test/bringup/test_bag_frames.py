# SPDX-License-Identifier: Apache-2.0
"""The frames of bags of other programs: encodings, compressed images, stamps, ROS 1."""

import cv2
from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.recorded_run import inspect_bag
from lowsnr_bringup.bags.replay import played_frames
from lowsnr_bringup.ros.film_bag import replayable
from lowsnr_bringup.ros.frame_bag import FrameBag
from lowsnr_bringup.truth.frame_index import Reading
from lowsnr_bringup.truth.frame_index import truth_at
import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import get_typestore
from rosbags.typesys import Stores

IMAGE, COMPRESSED = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage'
TOPIC, TRUTH = '/camera/image_raw', '/ground_truth'
SHAPE = (6, 8)
STEP = 100_000_000
ZERO = 1_700_000_000_000_000_000


def header(types, stamp_ns, *sequence):
    time = types['builtin_interfaces/msg/Time'](stamp_ns // 10**9, stamp_ns % 10**9)
    return types['std_msgs/msg/Header'](*sequence, time, 'lens')


def image(types, stamp_ns, pixels, encoding='mono16', *sequence):
    return types[IMAGE](
        header(types, stamp_ns, *sequence), *pixels.shape[:2], encoding, 0,
        pixels.nbytes // len(pixels), np.ascontiguousarray(pixels).view('u1').ravel())


def packed(types, stamp_ns, pixels, how='mono16; png compressed mono16', ending='.png'):
    return types[COMPRESSED](
        header(types, stamp_ns), how, cv2.imencode(ending, pixels)[1].ravel())


def write(path, messages, kind=IMAGE, topic=TOPIC):
    """Write a bag of ROS 2; ``messages`` takes the types and yields messages."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(topic, kind, typestore=store)
        for k, message in enumerate(messages(store.types)):
            writer.write(connection, ZERO + k * STEP, store.serialize_cdr(message, kind))
    return path


@pytest.fixture
def frames(rng):
    """Return eight frames."""
    return rng.integers(900, 1100, (8, *SHAPE)).astype('u2')


def refused(path, reason):
    with pytest.raises(UnusableFile) as caught:
        inspect_bag(path, TOPIC, TRUTH)
    assert caught.value.reason == reason
    assert str(caught.value).startswith(f'{path}: {TOPIC}: ')


@pytest.mark.parametrize(('stamps', 'left_out'), [
    ([1, 2, 3, 4, 5, 6, 7, 8], ()), ([1, 2, 3, 3, 5, 6, 7, 8], (3,)),  # repeated
    ([0, 2002, 2003, 2004, 2005, 2006, 2007, 2008], (0,)), ([0, 1, 2, 3, 4, 5, 6, 7], ()),
    ([1, 2, 0, 4, 5, 6, 7, 8], (2,)),
    ([1, 2, 3, 99, 5, 6, 7, 8], (3,)), ([1, 2, 3, 4, 1, 6, 7, 8], (4,)),  # ahead, late
    ([1, 3, 2, 4, 5, 7, 6, 8], (1, 5))])  # swapped
def test_stamp_that_is_out_of_order_costs_its_frame(tmp_path, frames, stamps, left_out):
    path = write(tmp_path / 'bag', lambda types: (
        image(types, second * 10**9, frame) for second, frame in zip(stamps, frames)))
    found = inspect_bag(path, TOPIC, TRUTH)
    assert (found.frames, found.left_out) == (8 - len(left_out), left_out)
    notes = [note for note in found.notes if f'{len(left_out)} of 8 frames' in note]
    assert len(notes) == bool(left_out)
    with Bag(path) as bag:
        played = [frame.stamp_ns for frame in played_frames(bag, TOPIC, '', left_out)]
    assert played == [
        stamp * 10**9 for k, stamp in enumerate(stamps) if k not in left_out]


@pytest.mark.parametrize('stamp', [0, 5])
def test_bag_whose_stamps_stand_still_is_refused(tmp_path, frames, stamp):
    refused(write(tmp_path / 'bag', lambda types: (
        image(types, stamp * 10**9, frame) for frame in frames)), 'stamps')


def test_encoding_that_nodes_do_not_take_is_refused_before_the_start(tmp_path, frames):
    floats = np.zeros((*SHAPE, 3), 'f4')
    refused(write(tmp_path / 'bag', lambda types: (
        image(types, ZERO + k, floats, '32FC3') for k in range(3))), 'wrong encoding')


@pytest.mark.parametrize(('kind', 'encoding'), [('i4', '32SC1'), ('f8', '64FC1')])
def test_noise_that_nodes_do_not_resolve_is_refused(tmp_path, frames, kind, encoding):
    for level, name in ((0, 'good'), (2**30, 'fine')):
        write(tmp_path / name, lambda types, level=level: (
            image(types, ZERO + k, frame.astype(kind) // 50 + level, encoding)
            for k, frame in enumerate(frames)))
    assert inspect_bag(tmp_path / 'good', TOPIC, TRUTH).encoding == encoding
    refused(tmp_path / 'fine', 'too fine')


def test_first_blank_pixel_of_frames_without_a_conditioner_is_found(tmp_path, frames):
    given = frames.astype('f4')
    given[2, 3, 4], given[5] = np.nan, 2e9
    for first, blank in ((0, 'frame 3'), (3, 'frame 3'), (6, '')):
        path = write(tmp_path / f'bag{first}', lambda types, first=first: (
            image(types, ZERO + k, frame, '32FC1') for k, frame in enumerate(given[first:])))
        assert inspect_bag(path, TOPIC, TRUTH).blank == blank


def test_compressed_images_are_unpacked_at_their_depth(tmp_path, frames):
    path = write(tmp_path / 'bag', lambda types: (
        packed(types, ZERO + k, frame) for k, frame in enumerate(frames)), COMPRESSED)
    found = inspect_bag(path, TOPIC, TRUTH)
    assert (found.frames, found.rows, found.cols, found.encoding) == (8, *SHAPE, 'mono16')


@pytest.mark.parametrize(('how', 'ending', 'encoding'), [
    ('jpeg', '.jpg', 'mono8'), ('bgr8; jpeg compressed bgr8', '.jpg', 'mono8'),
    ('png', '.png', 'mono8')])
def test_compressed_images_of_eight_bits(tmp_path, frames, how, ending, encoding):
    pixels = (frames // 8).astype('u1')
    path = write(tmp_path / 'bag', lambda types: (
        packed(types, ZERO + k, frame, how, ending) for k, frame in enumerate(pixels)),
        COMPRESSED)
    assert inspect_bag(path, TOPIC, TRUTH).encoding == encoding


@pytest.mark.parametrize(('how', 'reason'), [
    ('16UC1; compressedDepth png', 'wrong encoding'), ('h264', 'wrong encoding'),
    ('', 'wrong encoding'), ('tiff', 'wrong encoding')])
def test_other_compression_is_refused_by_name(tmp_path, frames, how, reason):
    refused(write(tmp_path / 'bag', lambda types: (
        packed(types, ZERO + k, frames[0], how) for k in range(2)), COMPRESSED), reason)


def test_damaged_compressed_image_is_refused(tmp_path, frames):
    def messages(types):
        good = packed(types, ZERO, frames[0])
        yield good
        yield types[COMPRESSED](header(types, ZERO + 1), 'png', good.data[:30])
    refused(write(tmp_path / 'bag', messages, COMPRESSED), 'unreadable')


@pytest.mark.parametrize('how', [None, 'BZ2', 'LZ4'])
def test_bag_of_ros_1_is_read(tmp_path, frames, how):
    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer1(tmp_path / 'night.bag')
    if how:
        writer.set_compression(Writer1.CompressionFormat[how])
    with writer:
        camera = writer.add_connection(TOPIC, IMAGE, typestore=store)
        text = writer.add_connection('/chatter', 'std_msgs/msg/String', typestore=store)
        for k, frame in enumerate(frames):
            message = image(store.types, ZERO + k * STEP, frame, 'mono16', k)
            message.header.seq = k
            writer.write(camera, k + 1, store.serialize_ros1(message, IMAGE))
            writer.write(text, k + 1, store.serialize_ros1(
                store.types['std_msgs/msg/String']('x'), 'std_msgs/msg/String'))
    found = inspect_bag(tmp_path / 'night.bag', TOPIC, TRUTH)
    assert (found.frames, found.rows, found.cols, found.period_s) == (8, *SHAPE, 0.1)
    with Bag(tmp_path / 'night.bag') as bag:
        assert bag.topics == {TOPIC: IMAGE}
        read = [bag.read(message) for message in bag.messages({TOPIC})]
    np.testing.assert_array_equal(
        [item.data.view('<u2').reshape(SHAPE) for item in read], frames)
    assert [item.header.stamp.nanosec for item in read] == [k * STEP for k in range(8)]


def test_damaged_bag_of_ros_1_is_refused_or_read_up_to_there(tmp_path, frames):
    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer1(tmp_path / 'night.bag') as writer:
        camera = writer.add_connection(TOPIC, IMAGE, typestore=store)
        for k, frame in enumerate(frames):
            writer.write(camera, k + 1, store.serialize_ros1(
                image(store.types, ZERO + k * STEP, frame, 'mono16', k), IMAGE))
    data = (tmp_path / 'night.bag').read_bytes()
    for size in range(0, len(data) - 1, 97):
        (tmp_path / 'cut.bag').write_bytes(data[:size])
        with pytest.raises(UnusableFile):
            inspect_bag(tmp_path / 'cut.bag', TOPIC, TRUTH)


def truth_of(path, table, folder, **how):
    """Return x and y of the truth of every frame that is replayed, and the notes."""
    found = replayable(path, folder, truth_file=table, frames_topic=TOPIC, **how)
    with Bag(found.bag) as bag, Bag(found.truth_bag) as other:
        left_out = inspect_bag(path, TOPIC, TRUTH).left_out
        played = [*played_frames(bag, TOPIC, TRUTH, left_out, other)]
        centres = [
            [(item.bbox.center.position.x, item.bbox.center.position.y)
             for item in other.read(frame.truth).detections] for frame in played]
    assert all(frame.image for frame in played)
    return centres, found.notes


def test_truth_of_a_table_joins_the_frames_of_a_camera(tmp_path, frames):
    stamps = [1, 2, 3, 3, 5, 6, 7, 8]
    path = write(tmp_path / 'bag', lambda types: (
        image(types, ZERO + second * STEP, frame) for second, frame in zip(stamps, frames)))
    table = tmp_path / 'truth.csv'
    table.write_text('Bild;Spalte;Zeile\n1;1,5;2\n4;9;9\n5;3;4,25\n')
    (tmp_path / 'a').mkdir()
    centres, notes = truth_of(path, table, tmp_path / 'a')
    # Numbers are those of the frames in the bag, also of the one that is left out.
    assert centres == [[(1.5, 2.0)], [], [], [(3.0, 4.25)], [], [], []]
    assert '1 of 3 positions' in notes[0]
    table.write_text('time,u,v\n0.0,1,2\n0.4,3,4\n')
    (tmp_path / 'b').mkdir()
    centres, _ = truth_of(path, table, tmp_path / 'b', reading=Reading())
    assert centres == [[(1.0, 2.0)], [], [], [(3.0, 4.0)], [], [], []]


@pytest.mark.parametrize(('x', 'delay_ns', 'said'), [
    (5.0, 0, []), (8.0, 0, ['8 of 8 positions']), (5.0, 1, ['no message has the stamp'])])
def test_truth_of_a_bag_that_cannot_be_hit_is_said(tmp_path, frames, x, delay_ns, said):
    with FrameBag(tmp_path / 'bag', frames_topic=TOPIC) as bag:
        for k, frame in enumerate(frames):
            bag.add(frame, ZERO + k * STEP, None)
            bag.add_truth(ZERO + k * STEP + delay_ns, [truth_at(x, 2.0)])
    notes = inspect_bag(tmp_path / 'bag', TOPIC, TRUTH).notes
    assert len(notes) == len(said)
    assert all(part in note for part, note in zip(said, notes))


def test_film_is_replayed_from_a_bag_of_its_own(tmp_path, frames):
    np.savez(tmp_path / 'night.npz', frames=frames, truth=np.ones((8, 2)))
    (tmp_path / 'a').mkdir()
    found = replayable(tmp_path / 'night.npz', tmp_path / 'a', period_s=0.5)
    run = inspect_bag(found.bag, None, TRUTH)
    assert (run.name, run.frames, run.period_s, run.truth, run.encoding) == (
        'night', 8, 0.5, True, 'mono16')
