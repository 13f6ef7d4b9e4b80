# SPDX-License-Identifier: Apache-2.0
"""convert.py makes bags that another reader reads, and rejects unusable files."""

from pathlib import Path
import subprocess
import sys

import cv2
from lowsnr_bringup.formats.film import FrameReader
from lowsnr_bringup.ros.film_bag import check_room
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_types_from_msg
from rosbags.typesys import get_typestore
from rosbags.typesys import Stores

ROOT = Path(__file__).resolve().parents[2]
SHAPE = (7, 5)


def convert(*arguments):
    """Run convert.py to its end."""
    return subprocess.run(
        [sys.executable, str(ROOT / 'scripts' / 'convert.py'), *map(str, arguments)],
        capture_output=True, text=True, timeout=120, check=False)


def read(bag):
    """Return images by stamp [ns], and truth (id, x, y) by stamp, as rosbags reads them."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for path in (ROOT / 'interfaces' / 'vision_msgs' / 'msg').glob('*.msg'):
        store.register(get_types_from_msg(path.read_text(), f'vision_msgs/msg/{path.stem}'))
    images, truth = {}, {}
    with AnyReader([bag], default_typestore=store) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            if connection.topic == '/clock':
                continue
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            if connection.topic == '/image_raw':
                images[stamp] = message
            elif connection.topic == '/ground_truth':
                truth[stamp] = [
                    (item.id, item.bbox.center.position.x, item.bbox.center.position.y)
                    for item in message.detections]
    return images, truth


@pytest.fixture
def archive(tmp_path, rng):
    """Return the path of an archive, and its frames."""
    frames = rng.integers(60_000, size=(4, *SHAPE)).astype('u2')
    truth = [[1.0, 2.0], [np.nan, np.nan], [3.5, 2.5], [0.0, 0.0]]
    np.savez(tmp_path / 'in.npz', frames=frames, truth=truth, t_s=[5.0, 7.0, 12.0, 14.0])
    return tmp_path / 'in.npz', frames


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_archive_becomes_a_bag(tmp_path, archive, storage):
    path, frames = archive
    done = convert(path, '--out', tmp_path / 'bag', '--storage', storage)
    assert (done.returncode, done.stderr) == (0, '')
    assert done.stdout.split()[0] == '4'
    images, truth = read(tmp_path / 'bag')
    # The first stamp is the median time between frames; then as t_s has it.
    assert [stamp / 1e9 for stamp in images] == [2.0, 4.0, 9.0, 11.0]
    for image, frame in zip(images.values(), frames):
        assert (image.encoding, image.height, image.width) == ('mono16', *SHAPE)
        np.testing.assert_array_equal(image.data.view('<u2').reshape(SHAPE), frame)
    assert [[item[1:] for item in found] for found in truth.values()] == [
        [(1.0, 2.0)], [], [(3.5, 2.5)], [(0.0, 0.0)]]


def test_folder_with_a_table_of_truth_becomes_a_bag(tmp_path, rng):
    folder = tmp_path / 'frames'
    folder.mkdir()
    for k in range(3):
        cv2.imwrite(str(folder / f'{k}.png'), rng.integers(255, size=SHAPE).astype('u1'))
    (tmp_path / 'truth.csv').write_text('frame,x,y,id\n2,1.5,3,a\n2,4,4,b\n')
    done = convert(
        folder, '--out', tmp_path / 'bag', '--rate', '20', '--truth', tmp_path / 'truth.csv')
    assert done.returncode == 0, done.stderr
    images, truth = read(tmp_path / 'bag')
    assert list(images) == [50_000_000, 100_000_000, 150_000_000]
    assert list(truth.values()) == [[], [('a', 1.5, 3.0), ('b', 4.0, 4.0)], []]


def test_frames_without_truth_make_a_bag_without(tmp_path):
    np.savez(tmp_path / 'in.npz', frames=np.zeros((2, *SHAPE)))
    assert convert(tmp_path / 'in.npz', '--out', tmp_path / 'bag').returncode == 0
    images, truth = read(tmp_path / 'bag')
    assert list(images) == [10**9, 2 * 10**9]
    assert {image.encoding for image in images.values()} == {'32FC1'}
    assert not truth


def test_help_shows_an_example():
    done = convert('--help')
    assert done.returncode == 0
    assert 'example: python scripts/convert.py' in ' '.join(done.stdout.split())


@pytest.mark.parametrize(('arguments', 'culprit'), [
    (['--period', '0'], '--period'),
    (['--period', '2', '--rate', '2'], '--rate'),
    (['--truth', 'none.csv'], 'none.csv'),
    (['--storage', 'zip'], '--storage'),
])
def test_bad_option_ends_with_one_line_and_nothing_written(tmp_path, archive, arguments, culprit):
    check_rejected(
        convert(archive[0], '--out', tmp_path / 'bag', *arguments), culprit, tmp_path / 'bag')


def test_mixed_frames_end_with_one_line_and_nothing_written(tmp_path):
    for k, shape in enumerate([SHAPE, SHAPE, (6, 5)]):
        cv2.imwrite(str(tmp_path / f'{k}.png'), np.zeros(shape, np.uint8))
    check_rejected(convert(tmp_path, '--out', tmp_path / 'bag'), '2.png', tmp_path / 'bag')


def test_bag_that_exists_is_left_alone(tmp_path, archive):
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag' / 'mine').touch()
    done = convert(archive[0], '--out', tmp_path / 'bag')
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert str(tmp_path / 'bag') in done.stderr
    assert [item.name for item in (tmp_path / 'bag').iterdir()] == ['mine']


@pytest.mark.parametrize(('count', 'fits'), [(3, True), (None, True), (10**9, False)])
def test_frames_that_the_disk_has_no_room_for_are_not_begun(tmp_path, count, fits):
    frames = FrameReader(lambda: iter(()), (1024, 1024), np.dtype(np.uint8), count)
    out = tmp_path / 'new' / 'bag'
    if fits:
        check_room(out, frames)
    else:
        with pytest.raises(ValueError, match=f'^{out}: .* {10**9 * (2**20 + 150)} bytes'):
            check_room(out, frames)


def check_rejected(done, culprit, bag):
    """Check status, the one line that names the culprit, and that no bag was left."""
    assert (done.returncode, done.stdout) == (2, '')
    assert len(done.stderr.splitlines()) == 1
    assert culprit in done.stderr
    assert not bag.exists()
