# SPDX-License-Identifier: Apache-2.0
"""Frames are read from archives, folders and videos as they are; unusable files are named."""

from astropy.io import fits
import cv2
from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats.image_files import open_frames
import numpy as np
import pytest

SHAPE = (7, 5)


def read(path):
    """Return the reader and its frames."""
    reader = open_frames(path)
    frames = list(reader)
    assert {frame.shape for frame in frames} == {reader.shape}
    assert {frame.dtype for frame in frames} == {reader.dtype}
    np.testing.assert_array_equal(frames, list(reader))  # which reads them again
    return reader, frames


def rejection(path):
    """Return the file that is named, and the reason for which it is rejected."""
    with pytest.raises(UnusableFile) as caught:
        read(path)
    assert str(caught.value).startswith(f'{caught.value.path}: ')
    assert str(caught.value).isprintable()
    return caught.value.path, caught.value.reason


@pytest.fixture
def archive(tmp_path):
    def write(**arrays):
        path = tmp_path / 'frames.npz'
        np.savez(path, **arrays)
        return path
    return write


@pytest.mark.parametrize(('given', 'stored'), [
    ('u1', 'u1'), ('<u2', 'u2'), ('>u2', 'u2'), ('i2', 'f4'), ('f4', 'f4'), ('f8', 'f4')])
def test_archive_is_read_as_it_is(archive, rng, given, stored):
    frames = rng.integers(200, size=(4, *SHAPE)).astype(given)
    truth = np.array([[1.0, 2.0], [np.nan, np.nan], [3.0, 2.5], [0.0, 0.0]])
    reader, found = read(archive(frames=frames, truth=truth, t_s=[0.0, 1.0, 2.5, 9.0], more=1))
    np.testing.assert_array_equal(found, frames)
    assert {frame.dtype for frame in found} == {np.dtype(stored)}
    np.testing.assert_array_equal(reader.truth, truth)
    assert reader.times_s().tolist() == [0.0, 1.0, 2.5, 9.0]


@pytest.mark.parametrize(('arrays', 'reason'), [
    ({'pixels': np.zeros((2, *SHAPE)), 'more': np.zeros((2, *SHAPE))}, 'no frames'),
    ({'pixels': np.zeros(2)}, 'no frames'),
    ({'frames': np.zeros(SHAPE)}, 'not frames'),
    ({'frames': np.zeros((0, *SHAPE))}, 'not frames'),
    ({'frames': np.zeros((2, *SHAPE)), 'truth': np.zeros((3, 2))}, 'bad truth'),
    ({'frames': np.zeros((2, *SHAPE)), 't_s': np.zeros(2)}, 'bad t_s'),
    ({'frames': np.zeros((2, *SHAPE)), 't_s': [0.0, np.nan]}, 'bad t_s'),
    ({'frames': np.zeros((2, *SHAPE)), 't_s': ['a', 'b']}, 'bad t_s'),
    ({'frames': np.full((2, *SHAPE), np.nan)}, 'not finite'),
    ({'frames': np.zeros((2, *SHAPE), dtype=complex)}, 'not frames'),
])
def test_unusable_archive_is_named(archive, arrays, reason):
    path = archive(**arrays)
    assert rejection(path) == (path, reason)


@pytest.mark.parametrize('content', [b'', b'not an archive', b'PK\x03\x04 cut'])
def test_unreadable_archive_is_named(tmp_path, content):
    path = tmp_path / 'frames.npz'
    path.write_bytes(content)
    assert rejection(path) == (path, 'unreadable')


@pytest.mark.parametrize('ending', ['png', 'tiff'])
@pytest.mark.parametrize('kind', ['u1', 'u2'])
def test_folder_is_read_in_the_order_of_its_numbers(tmp_path, rng, ending, kind):
    frames = rng.integers(250, size=(12, *SHAPE)).astype(kind)
    for k, frame in enumerate(frames):
        cv2.imwrite(str(tmp_path / f'frame_{k}.{ending}'), frame)
    (tmp_path / 'notes.txt').write_text('not a frame')
    _, found = read(tmp_path)
    np.testing.assert_array_equal(found, frames)
    assert found[0].dtype == np.dtype(kind)


@pytest.mark.parametrize(('kind', 'stored'), [('u2', 'u2'), ('i2', 'f4'), ('f4', 'f4')])
def test_fits_images_are_read(tmp_path, rng, kind, stored):
    frames = rng.integers(30_000, size=(3, *SHAPE)).astype(kind)
    for k, frame in enumerate(frames):
        fits.writeto(tmp_path / f'{k}.fits', frame)
    _, found = read(tmp_path)
    np.testing.assert_array_equal(found, frames)
    assert found[0].dtype == np.dtype(stored)


def test_colour_becomes_grey_with_a_note(tmp_path):
    image = np.zeros((*SHAPE, 3), dtype=np.uint8)
    image[..., 1] = 100
    cv2.imwrite(str(tmp_path / 'a.png'), image)
    reader, (frame,) = read(tmp_path)
    # Luminance of green, ITU-R BT.601.
    assert frame.tolist() == np.full(SHAPE, round(0.587 * 100)).tolist()
    assert len(reader.notes) == 1
    cv2.imwrite(str(tmp_path / 'a.png'), np.full((*SHAPE, 3), 9, np.uint8))
    assert open_frames(tmp_path).notes == []


def test_unusable_folder_is_named(tmp_path):
    assert rejection(tmp_path) == (tmp_path, 'no frames')
    cv2.imwrite(str(tmp_path / 'a1.png'), np.zeros(SHAPE, np.uint8))
    cv2.imwrite(str(tmp_path / 'a2.png'), np.zeros((7, 6), np.uint8))
    assert rejection(tmp_path) == (tmp_path / 'a2.png', 'mixed')
    (tmp_path / 'a2.png').write_bytes(b'nothing of the kind')
    assert rejection(tmp_path) == (tmp_path / 'a2.png', 'unreadable')
    (tmp_path / 'a2.fits').write_bytes(b'nothing of the kind')
    assert rejection(tmp_path) == (tmp_path, 'several kinds')
    assert rejection(tmp_path / 'a2.fits') == (tmp_path / 'a2.fits', 'unreadable')


def test_video_is_read_with_its_rate(tmp_path):
    path = tmp_path / 'film.avi'
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*'MJPG'), 25.0, (64, 48))
    for k in range(6):
        writer.write(np.full((48, 64, 3), 40 * k, np.uint8))
    writer.release()
    reader, found = read(path)
    assert reader.period_s == pytest.approx(0.04)
    assert [frame.shape for frame in found] == [(48, 64)] * 6
    np.testing.assert_allclose([frame.mean() for frame in found], range(0, 240, 40), atol=3)


def test_other_files_are_named(tmp_path):
    assert rejection(tmp_path / 'missing') == (tmp_path / 'missing', 'missing')
    path = tmp_path / 'text.mp4'
    path.write_text('no video')
    assert rejection(path) == (path, 'unreadable')


@pytest.mark.parametrize(('t_s', 'period_s', 'stamps_s'), [
    (None, None, [1.0, 2.0, 3.0]), (None, 0.5, [0.5, 1.0, 1.5]),
    ([5.0, 7.0, 12.0], None, [3.5, 5.5, 10.5]), ([5.0, 7.0, 12.0], 0.25, [0.25, 0.5, 0.75])])
def test_stamps_begin_a_period_after_zero(archive, t_s, period_s, stamps_s):
    path = archive(frames=np.zeros((3, *SHAPE)), **({} if t_s is None else {'t_s': t_s}))
    reader = open_frames(path)
    found = [stamp_ns / 1e9 for _, stamp_ns in reader.stamped(period_s)]
    assert found == stamps_s
