# SPDX-License-Identifier: Apache-2.0
"""Files that declare or unpack to gigabytes are read piece by piece, or rejected at once."""

import gzip
import io
import lzma
import struct
import tracemalloc
import zipfile

import cv2
import imagecodecs  # noqa: F401  (here, so that its memory does not count)
from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats import npz
from lowsnr_bringup.formats.image_files import open_frames
from lowsnr_common.images.compressed import MOST_PIXELS
import numpy as np
import pytest
import tifffile  # noqa: F401

MIB = 2**20


def npy(shape, kind='|u1', columns_first=False):
    """Return the header of an array."""
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        file, {'descr': kind, 'fortran_order': columns_first, 'shape': shape})
    return file.getvalue()


def archive(path, header, mebibytes, how=zipfile.ZIP_DEFLATED):
    """Write an archive of zeros, much smaller than what it unpacks to."""
    with zipfile.ZipFile(path, 'w', how) as file, file.open('frames.npy', 'w') as array:
        array.write(header)
        for _ in range(mebibytes):
            array.write(bytes(MIB))
    return path


def rejected(path):
    """Return the reason for which frames are rejected, which takes little memory."""
    tracemalloc.start()
    try:
        with pytest.raises(UnusableFile) as caught:
            list(open_frames(path))
        assert tracemalloc.get_traced_memory()[1] < 32 * MIB
    finally:
        tracemalloc.stop()
    assert str(caught.value).isprintable()
    return caught.value.reason


def test_archive_is_read_a_frame_at_a_time(tmp_path):
    path = archive(tmp_path / 'a.npz', npy((256, 1024, 1024)), 256)
    assert path.stat().st_size < 2 * MIB
    tracemalloc.start()
    try:
        reader = open_frames(path)
        assert sum(frame.size for frame in reader) == 256 * MIB
        assert tracemalloc.get_traced_memory()[1] < 16 * MIB
    finally:
        tracemalloc.stop()
    assert reader.count == 256


@pytest.mark.parametrize(('header', 'reason'), [
    (npy((1, 2**15, 2**16)), 'unreadable'), (npy((10**12, 1, 2**25)), 'unreadable'),
    (npy((10**30, 10**30, 10**30)), 'unreadable'), (npy((1, -MIB, -1)), 'unreadable'),
    (npy((1, MIB, 1), '|O'), 'not frames'), (npy((1, MIB, 1), '<c8'), 'not frames'),
    (b'\x93NUMPY\x09\x00', 'unreadable')])
def test_header_that_lies_is_rejected(tmp_path, header, reason):
    assert rejected(archive(tmp_path / 'a.npz', header, 1)) == reason


def test_frame_that_is_too_large_is_rejected(tmp_path):
    assert rejected(archive(tmp_path / 'a.npz', npy((1, 65, MIB)), 65)) == 'too large'


def test_large_archive_in_the_order_of_columns_is_rejected(tmp_path, monkeypatch):
    path = archive(tmp_path / 'a.npz', npy((2, MIB // 2, 1), columns_first=True), 1)
    assert [frame.shape for frame in open_frames(path)] == [(MIB // 2, 1)] * 2
    monkeypatch.setattr(npz, 'MAX_BYTES', MIB - 1)
    assert rejected(path) == 'too large'


@pytest.mark.parametrize('how', [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_compression_that_unpacks_all_at_once_is_rejected(tmp_path, how):
    assert rejected(archive(tmp_path / 'a.npz', npy((64, 1024, 1024)), 64, how)) == 'unreadable'


def test_archive_in_the_order_of_columns_is_read(tmp_path, rng):
    frames = rng.integers(255, size=(3, 4, 5)).astype(np.uint8)
    np.savez(tmp_path / 'a.npz', frames=np.asfortranarray(frames))
    np.testing.assert_array_equal(list(open_frames(tmp_path / 'a.npz')), frames)


@pytest.mark.parametrize('name', ['t_s', 'truth'])
def test_times_and_truth_of_too_many_frames_are_rejected(tmp_path, monkeypatch, name):
    monkeypatch.setattr(npz, 'MOST_FRAMES', 3)
    found = {'t_s': np.arange(4.0), 'truth': np.zeros((4, 2))}[name]
    np.savez(tmp_path / 'a.npz', frames=np.zeros((4, 5, 6)), **{name: found})
    assert rejected(tmp_path / 'a.npz') == 'too large'


def png(width, height):
    """Return a PNG of any declared size."""
    good = cv2.imencode('.png', np.zeros((3, 4), np.uint8))[1].tobytes()
    return good[:16] + struct.pack('>II', width, height) + good[24:]


def tiff(width, height, order='<', big=False):
    """Return a TIFF or BigTIFF of any declared size, without pixels."""
    size = 'Q' if big else 'I'
    fields = [(256, width), (257, height), (258, 8), (259, 1), (262, 1), (273, 8), (277, 1)]
    start = 16 if big else 8
    head = {'<': b'II', '>': b'MM'}[order] + struct.pack(
        f'{order}HHHQ' if big else f'{order}HI', *((43, 8, 0, start) if big else (42, start)))
    return head + struct.pack(f'{order}{"Q" if big else "H"}', len(fields)) + b''.join(
        struct.pack(f'{order}HH{size}{size}', tag, 16 if big else 4, 1, value)
        for tag, value in fields) + bytes(8)


def fits_image(width, height):
    """Return a FITS image of any declared size, without pixels."""
    cards = ['SIMPLE  =                    T', 'BITPIX  =                    8',
             'NAXIS   =                    2', f'NAXIS1  = {width:>20}',
             f'NAXIS2  = {height:>20}', 'END']
    return ''.join(card.ljust(80) for card in cards).ljust(2880).encode() + bytes(2880)


LARGE = {
    'a.png': png(30_000, 30_000), 'b.png': png(2**31 - 1, 2**31 - 1),
    'a.tif': tiff(30_000, 30_000), 'b.tif': tiff(30_000, 30_000, '>'),
    'c.tif': tiff(2**40, 2**40, big=True), 'd.tif': tiff(30_000, 30_000, '>', big=True),
    'a.fits': fits_image(30_000, 30_000),
}


@pytest.mark.parametrize('name', LARGE)
def test_image_that_declares_a_huge_size_is_rejected(tmp_path, name):
    (tmp_path / name).write_bytes(LARGE[name])
    assert rejected(tmp_path) == 'too large'


@pytest.mark.parametrize(('name', 'data'), [
    ('a.png', b'P5 30000 30000 255\n'), ('a.tif', b'II*\0\xff\xff\xff\xff'),
    ('a.tif', tiff(4, 3)[:30]), ('a.png', b''), ('a.png', png(4, 3)[:20]),
    ('a.fits', gzip.compress(b'no image', mtime=0)),
    ('a.fits', lzma.compress(fits_image(4, 3))), ('a.fits', fits_image(2**40, 2**40))])
def test_other_content_than_the_name_says_is_rejected(tmp_path, name, data):
    (tmp_path / name).write_bytes(data)
    assert rejected(tmp_path) == 'unreadable'


@pytest.mark.parametrize('how', ['folder', 'link'])
def test_image_that_is_no_file_is_rejected(tmp_path, how):
    if how == 'folder':
        (tmp_path / 'a.png').mkdir()
    else:
        (tmp_path / 'a.png').symlink_to('nowhere')
    assert rejected(tmp_path) == 'unreadable'


@pytest.mark.parametrize('kind', ['u1', 'u2', 'f4', 'f8'])
def test_tiff_of_any_depth_is_read(tmp_path, rng, kind):
    image = (200 * rng.random((7, 5))).astype(kind)
    cv2.imwrite(str(tmp_path / 'a.tif'), image)
    frame, = open_frames(tmp_path)
    np.testing.assert_allclose(frame, image, rtol=1e-6)


def test_largest_frame_is_that_of_large_cameras():
    assert 9_576 * 6_388 <= MOST_PIXELS < 30_000 * 30_000
