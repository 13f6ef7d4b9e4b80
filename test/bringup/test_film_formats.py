# SPDX-License-Identifier: Apache-2.0
"""Files of many formats, each made by another library, give all frames at their depth."""

import struct
import sys

import cv2
from film_files import read
from film_files import reason
from film_files import SHAPE
from film_files import twelve_bit_frames
from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats.image_files import open_frames
import numpy as np
import PIL.Image
import pytest
import tifffile


@pytest.fixture
def frames(rng):
    return twelve_bit_frames(rng)


@pytest.mark.parametrize('kind', ['u1', '>u2', 'i1', 'i2', 'f4', 'f8'])
@pytest.mark.parametrize('how', [
    {}, {'compression': 'zlib'}, {'compression': 'lzw', 'predictor': True}, {'bigtiff': True}])
def test_all_pages_of_a_tiff_are_read(tmp_path, frames, kind, how):
    given = (frames - 1000).astype(kind) if np.dtype(kind).itemsize == 1 else frames.astype(kind)
    tifffile.imwrite(tmp_path / 'a.tif', given, photometric='minisblack', **how)
    for path in (tmp_path, tmp_path / 'a.tif'):
        reader, found, stamps = read(path)
        np.testing.assert_array_equal(found, given)
        assert reader.count == 6
        assert found.dtype == (given.dtype.newbyteorder('=') if given.dtype.kind == 'u' else 'f4')
        assert stamps == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]


def test_imagej_stack_has_its_interval_and_pages_without_headers(tmp_path, frames):
    tifffile.imwrite(
        tmp_path / 'a.tif', frames, imagej=True, metadata={'axes': 'TYX', 'finterval': 0.04})
    _, found, stamps = read(tmp_path / 'a.tif')
    np.testing.assert_array_equal(found, frames)
    np.testing.assert_allclose(stamps, 0.04 * np.arange(1, 7))
    with tifffile.TiffFile(tmp_path / 'a.tif') as file:
        second = file.pages[0].offset
        count = len(file.pages[0].tags)
    data = bytearray((tmp_path / 'a.tif').read_bytes())
    end = second + 2 + 12 * count
    data[end:end + 4] = bytes(4)  # as ImageJ writes a stack beyond 4 GB
    (tmp_path / 'a.tif').write_bytes(data)
    reader, found, _ = read(tmp_path / 'a.tif')
    assert reader.count == 6
    np.testing.assert_array_equal(found, frames)


def test_tiff_of_twelve_packed_bits_is_read(tmp_path, frames):
    bits = np.unpackbits(frames[0].astype('>u2')[..., None].view('u1'), axis=-1)[..., 4:]
    data = np.packbits(bits.reshape(SHAPE[0], -1), axis=1).tobytes()
    tags = [(256, 4, SHAPE[1]), (257, 4, SHAPE[0]), (258, 3, 12), (259, 3, 1), (262, 3, 1),
            (273, 4, 8), (277, 3, 1), (278, 4, SHAPE[0]), (279, 4, len(data))]
    head = struct.pack('<2sHI', b'II', 42, 8 + len(data))
    fields = b''.join(struct.pack('<HHII', tag, kind, 1, value) for tag, kind, value in tags)
    (tmp_path / 'a.tif').write_bytes(
        head + data + struct.pack('<H', len(tags)) + fields + bytes(4))
    np.testing.assert_array_equal(read(tmp_path / 'a.tif')[1][0], frames[0])


@pytest.mark.parametrize('kind', ['u1', 'u2', 'f4', 'f8'])
def test_colours_of_a_tiff_become_luminance(tmp_path, rng, kind):
    image = (200.0 * rng.random((*SHAPE, 3))).astype(kind)
    tifffile.imwrite(tmp_path / 'a.tif', image, photometric='rgb')
    reader, found, _ = read(tmp_path)
    np.testing.assert_allclose(found[0], image @ [0.299, 0.587, 0.114], atol=0.6)
    assert len(reader.notes) == 1


def test_white_is_zero_and_no_data_are_read_as_declared(tmp_path, frames):
    tifffile.imwrite(tmp_path / 'a.tif', frames[0], photometric='miniswhite')
    np.testing.assert_array_equal(read(tmp_path / 'a.tif')[1][0], 65535 - frames[0])
    bits = frames[0] > 1030
    tifffile.imwrite(tmp_path / 'c.tif', bits, photometric='miniswhite')
    np.testing.assert_array_equal(read(tmp_path / 'c.tif')[1][0], ~bits)
    tifffile.imwrite(tmp_path / 'b.tif', frames[0], extratags=[(42113, 's', 0, '1000', True)])
    reader, found, _ = read(tmp_path / 'b.tif')
    np.testing.assert_array_equal(np.isnan(found[0]), frames[0] == 1000)
    assert len(reader.notes) == 1


def test_smaller_copies_of_a_tiff_are_no_frames(tmp_path, frames):
    with tifffile.TiffWriter(tmp_path / 'a.tif') as file:
        for frame in frames:
            file.write(frame)
            file.write(frame[::2, ::2], subfiletype=1)
    np.testing.assert_array_equal(read(tmp_path / 'a.tif')[1], frames)


def test_npy_and_any_key_of_an_npz_are_read(tmp_path, frames):
    np.save(tmp_path / 'a.npy', frames)
    np.testing.assert_array_equal(read(tmp_path / 'a.npy')[1], frames)
    np.savez(tmp_path / 'b.npz', cube=frames, other=np.zeros(3))
    reader, found, _ = read(tmp_path / 'b.npz')
    np.testing.assert_array_equal(found, frames)
    assert 'other' in reader.notes[0]
    np.savez(tmp_path / 'c.npz', one=frames, two=frames + 1)
    with pytest.raises(UnusableFile, match=r'one shape \(6, 24, 32\) of uint16, two') as caught:
        open_frames(tmp_path / 'c.npz')
    assert caught.value.reason == 'no frames'
    np.testing.assert_array_equal(read(tmp_path / 'c.npz', select='two')[1], frames + 1)
    for k, frame in enumerate(frames):
        (tmp_path / 'folder').mkdir(exist_ok=True)
        np.save(tmp_path / 'folder' / f'{k}.npy', np.asfortranarray(frame))
    np.testing.assert_array_equal(read(tmp_path / 'folder')[1], frames)


def test_npy_of_one_picture_in_colours_is_one_frame(tmp_path, frames):
    np.save(tmp_path / 'a.npy', np.repeat(frames[0][..., None], 3, axis=2))
    np.testing.assert_allclose(read(tmp_path / 'a.npy')[1], frames[:1], atol=0.5)


def test_times_that_no_stamp_holds_are_refused(tmp_path, frames):
    np.savez(tmp_path / 'a.npz', frames=frames, t_s=1e9 * np.arange(6.0))  # nanoseconds
    assert reason(tmp_path / 'a.npz') == 'stamps'


def test_jpeg_is_read_as_another_library_reads_it(tmp_path, frames):
    for k, frame in enumerate(frames):
        PIL.Image.fromarray((frame // 8).astype('u1')).save(tmp_path / f'{k}.jpg', quality=95)
    expected = [np.asarray(PIL.Image.open(tmp_path / f'{k}.jpg')) for k in range(6)]
    np.testing.assert_allclose(read(tmp_path)[1].astype(int), expected, atol=1)


@pytest.mark.parametrize('bits', [8, 16])
def test_pgm_is_read_at_its_depth(tmp_path, frames, bits):
    given = frames if bits == 16 else (frames // 8).astype('u1')
    for k, frame in enumerate(given):
        cv2.imwrite(str(tmp_path / f'{k}.pgm'), frame)
    np.testing.assert_array_equal(read(tmp_path)[1], given)
    data = b''.join((tmp_path / f'{k}.pgm').read_bytes() for k in range(6))
    (tmp_path / 'all').mkdir()
    (tmp_path / 'all' / 'a.pgm').write_bytes(data)
    np.testing.assert_array_equal(read(tmp_path / 'all')[1], given)


def test_pgm_of_text_and_with_a_small_maximum_is_read_as_it_is(tmp_path):
    (tmp_path / 'a.pgm').write_text('P2 # made by hand\n3 2\n4095\n0 1 2\n4095 7 9\n')
    found = read(tmp_path / 'a.pgm')[1]
    assert (found[0].tolist(), found.dtype) == ([[0, 1, 2], [4095, 7, 9]], np.uint16)
    (tmp_path / 'a.pgm').write_bytes(b'P5 3 1 15 \x01\x0f\x07')
    assert read(tmp_path / 'a.pgm')[1].tolist() == [[[1, 15, 7]]]
    for bad in (b'P2 3 2 255 1 2 x 4 5 6', b'P5 3 1 255 a', b'P9 3 1 255 abc', b'P5 3 1 0 abc',
                b'P2 2 1 255 300 1', b'P2 2 1 255 -1 1', b'P5 2 1 15 \x01\x10'):
        (tmp_path / 'a.pgm').write_bytes(bad)
        assert reason(tmp_path / 'a.pgm') == 'unreadable'


def test_folder_of_several_kinds_is_refused_unless_a_pattern_picks(tmp_path, frames):
    for k, frame in enumerate(frames):
        tifffile.imwrite(tmp_path / f'{k}.tif', frame)
        PIL.Image.fromarray((frame // 8).astype('u1')).save(tmp_path / f'{k}.jpg')
    assert reason(tmp_path) == 'several kinds'
    np.testing.assert_array_equal(read(tmp_path, pattern='*.tif')[1], frames)


@pytest.mark.parametrize(('array', 'why'), [
    (np.full((2, *SHAPE), 2e9), 'too large'), (np.full((2, *SHAPE), 1e300), 'too large'),
    (np.full((2, *SHAPE), np.nan), 'not finite'),
    (np.zeros((2, *SHAPE), 'c8'), 'not frames'),
    (9e8 + np.random.default_rng(0).normal(0.0, 1.0, (2, *SHAPE)), 'too fine'),
    (np.random.default_rng(0).integers(2**29, 2**29 + 9, (2, *SHAPE)), 'too fine')])
def test_numbers_that_are_not_kept_are_refused(tmp_path, array, why):
    np.save(tmp_path / 'a.npy', array)
    assert reason(tmp_path / 'a.npy') == why


def test_blank_pixels_stay_blank(tmp_path, frames):
    given = frames.astype('f4')
    given[:, :, :3], given[2, 5, 7] = np.nan, np.inf
    np.save(tmp_path / 'a.npy', given)
    reader, found, _ = read(tmp_path / 'a.npy')
    np.testing.assert_array_equal(found, np.where(np.isinf(given), np.nan, given))
    assert f'{6 * 24 * 3 + 1} pixels of 6 frames' in reader.notes[0]


def test_missing_library_is_named(tmp_path, frames, monkeypatch):
    tifffile.imwrite(tmp_path / 'a.tif', frames)
    monkeypatch.setitem(sys.modules, 'tifffile', None)
    with pytest.raises(UnusableFile, match='pip install tifffile') as caught:
        open_frames(tmp_path)
    assert caught.value.reason == 'no reader'
