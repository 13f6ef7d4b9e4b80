"""Frames are read from archives, folders and videos as they are; what does not fit is named."""

from astropy.io import fits
import cv2
from lowsnr_bringup.bags.image_files import open_recording
import numpy as np
import pytest

SHAPE = (7, 5)


def read(path):
    """Return the recording and its frames."""
    recording = open_recording(path)
    return recording, list(recording.frames)


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
    recording, found = read(archive(frames=frames, truth=truth, t_s=[0.0, 1.0, 2.5, 9.0], more=1))
    np.testing.assert_array_equal(found, frames)
    assert {frame.dtype for frame in found} == {np.dtype(stored)}
    np.testing.assert_array_equal(recording.truth, truth)
    assert recording.times_s.tolist() == [0.0, 1.0, 2.5, 9.0]


@pytest.mark.parametrize(('arrays', 'said'), [
    ({'pixels': np.zeros((2, *SHAPE))}, 'has no array frames'),
    ({'frames': np.zeros(SHAPE)}, r'frames has shape \(7, 5\), must be'),
    ({'frames': np.zeros((0, *SHAPE))}, r'frames has shape \(0, 7, 5\)'),
    ({'frames': np.zeros((2, *SHAPE)), 'truth': np.zeros((3, 2))}, 'truth has shape'),
    ({'frames': np.zeros((2, *SHAPE)), 't_s': np.zeros(2)}, 't_s does not rise'),
    ({'frames': np.zeros((2, *SHAPE)), 't_s': [0.0, np.nan]}, 't_s does not rise'),
    ({'frames': np.zeros((2, *SHAPE)), 't_s': ['a', 'b']}, 't_s has shape'),
    ({'frames': np.full((2, *SHAPE), np.nan)}, 'frame 1: row 0, column 0 is not a finite'),
    ({'frames': np.zeros((2, *SHAPE), dtype=complex)}, 'is not a grey image'),
])
def test_archive_that_does_not_fit_is_named(archive, arrays, said):
    with pytest.raises(ValueError, match=said):
        read(archive(**arrays))


@pytest.mark.parametrize('content', [b'', b'not an archive', b'PK\x03\x04 cut'])
def test_archive_that_is_none_is_named(tmp_path, content):
    path = tmp_path / 'frames.npz'
    path.write_bytes(content)
    with pytest.raises(ValueError, match='frames.npz: cannot be read'):
        read(path)


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


def test_colour_becomes_grey_and_that_is_said(tmp_path):
    image = np.zeros((*SHAPE, 3), dtype=np.uint8)
    image[..., 1] = 100
    cv2.imwrite(str(tmp_path / 'a.png'), image)
    recording, (frame,) = read(tmp_path)
    # Luminance of green, ITU-R BT.601.
    assert frame.tolist() == np.full(SHAPE, round(0.587 * 100)).tolist()
    assert recording.remarks == ['colour frames are turned to grey']


def test_folder_that_does_not_fit_is_named(tmp_path):
    with pytest.raises(ValueError, match='holds no image'):
        read(tmp_path)
    cv2.imwrite(str(tmp_path / 'a1.png'), np.zeros(SHAPE, np.uint8))
    cv2.imwrite(str(tmp_path / 'a2.png'), np.zeros((7, 6), np.uint8))
    with pytest.raises(ValueError, match='a2.png: 6 x 7 pixels of uint8, the first frame has 5'):
        read(tmp_path)
    for name in ('a2.png', 'a2.fits'):
        (tmp_path / 'a2.png').unlink(missing_ok=True)
        (tmp_path / name).write_bytes(b'nothing of the kind')
        with pytest.raises(ValueError, match=f'{name}: not a'):
            read(tmp_path)


def test_video_is_read_with_its_rate(tmp_path):
    path = tmp_path / 'film.avi'
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*'MJPG'), 25.0, (64, 48))
    for k in range(6):
        writer.write(np.full((48, 64, 3), 40 * k, np.uint8))
    writer.release()
    recording, found = read(path)
    assert recording.period_s == pytest.approx(0.04)
    assert [frame.shape for frame in found] == [(48, 64)] * 6
    np.testing.assert_allclose([frame.mean() for frame in found], range(0, 240, 40), atol=3)


def test_what_is_no_frames_at_all_is_named(tmp_path):
    with pytest.raises(ValueError, match='there is no such file or folder'):
        read(tmp_path / 'missing')
    path = tmp_path / 'text.mp4'
    path.write_text('no video')
    with pytest.raises(ValueError, match='neither an .npz, a folder of images nor a video'):
        read(path)
