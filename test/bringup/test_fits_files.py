# SPDX-License-Identifier: Apache-2.0
"""FITS files of every structure give all frames, scaled, with blanks and with their times."""

import gzip
import struct

from astropy.io import fits
from film_files import read
from film_files import reason
from film_files import SHAPE
from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats import fits as fits_format
from lowsnr_bringup.formats.fits_dates import unix_ns
from lowsnr_bringup.formats.image_files import open_frames
import numpy as np
import pytest

START_S = 1_767_225_600.0  # 2026-01-01T00:00:00


@pytest.fixture
def frames(rng):
    """Return six frames of 16 bits."""
    return np.rint(rng.normal(33_000.0, 20.0, (6, *SHAPE))).astype('u2')


def dated(second, **more):
    """Return a header with a time."""
    text = f'2026-01-01T{second // 3600:02}:{second // 60 % 60:02}:{second % 60:02}'
    return fits.Header({'DATE-OBS': text} | more)


@pytest.mark.parametrize('shape', [(6, *SHAPE), (6, 1, *SHAPE), (1, 6, *SHAPE)])
@pytest.mark.parametrize('packed', [False, True])
def test_planes_of_a_cube_are_frames(tmp_path, frames, shape, packed):
    kind = fits.CompImageHDU if packed else fits.ImageHDU
    fits.HDUList([fits.PrimaryHDU(), kind(frames.reshape(shape))]).writeto(tmp_path / 'a.fits')
    reader, found, stamps = read(tmp_path / 'a.fits')
    assert (reader.count, found.dtype, stamps[-1]) == (6, np.uint16, 6.0)
    np.testing.assert_array_equal(found, frames)


def test_three_planes_that_may_be_colours_are_said(tmp_path, frames):
    fits.writeto(tmp_path / 'a.fits', frames[:3])
    reader, found, _ = read(tmp_path)
    assert (len(found), len(reader.notes)) == (3, 1)


def test_third_axis_of_length_one_is_no_cube(tmp_path, frames):
    for k, frame in enumerate(frames):
        fits.writeto(tmp_path / f'{k}.fits', frame[None])
    np.testing.assert_array_equal(read(tmp_path)[1], frames)


def test_extensions_of_one_shape_are_frames_with_their_times(tmp_path, frames):
    units = [fits.ImageHDU(frame, dated(10 * k)) for k, frame in enumerate(frames)]
    fits.HDUList([fits.PrimaryHDU(), *units]).writeto(tmp_path / 'a.fits')
    _, found, stamps = read(tmp_path / 'a.fits')
    np.testing.assert_array_equal(found, frames)
    assert stamps == [START_S + 10 * k for k in range(6)]


@pytest.mark.parametrize('name', ['MASK', 'DQ', 'ERR'])
def test_mask_before_the_image_is_not_taken_for_it(tmp_path, frames, name):
    for k, frame in enumerate(frames):
        fits.HDUList([
            fits.PrimaryHDU(), fits.ImageHDU(frame % 2, name=name),
            fits.ImageHDU(frame, name='SCI' if k < 3 else 'CHIP')]).writeto(
                tmp_path / f'{k}.fits')
    np.testing.assert_array_equal(read(tmp_path)[1], frames)
    np.testing.assert_array_equal(read(tmp_path, select=name.lower())[1], frames % 2)
    np.testing.assert_array_equal(read(tmp_path, select='2')[1], frames)


def test_images_of_several_kinds_are_refused_by_name(tmp_path, frames):
    fits.HDUList([
        fits.PrimaryHDU(frames[0]), fits.ImageHDU(frames[0][:9], name='GUIDE')]).writeto(
            tmp_path / 'a.fits')
    with pytest.raises(UnusableFile, match=r'PRIMARY \(32 x 24.*GUIDE \(32 x 9') as caught:
        open_frames(tmp_path)
    assert caught.value.reason == 'several images'
    assert read(tmp_path, select='guide')[1].shape == (1, 9, 32)
    assert reason(tmp_path, select='NONE') == 'no frames'


@pytest.mark.parametrize('ending', ['fits', 'fits.gz', 'fits.fz'])
@pytest.mark.parametrize('kind', ['u1', 'i2', 'u2', 'i4', 'f4', 'f8'])
def test_compressed_files_are_read(tmp_path, frames, ending, kind):
    given = (frames - 32_900).astype(kind)
    for k, frame in enumerate(given):
        unit = fits.CompImageHDU(frame, quantize_level=0, compression_type='GZIP_1') if (
            ending.endswith('fz')) else fits.PrimaryHDU(frame)
        unit.writeto(tmp_path / f'{k}.{ending}')
    found = read(tmp_path)[1]
    np.testing.assert_array_equal(found, given)
    assert found.dtype == (kind if kind in ('u1', 'u2') else 'f4')


@pytest.mark.parametrize('way', ['RICE_1', 'GZIP_1', 'GZIP_2', 'PLIO_1', 'HCOMPRESS_1'])
def test_every_way_of_compression_is_read(tmp_path, frames, way):
    given = (frames - 32_000).astype('i2')
    fits.CompImageHDU(given[0], compression_type=way).writeto(tmp_path / 'a.fits')
    np.testing.assert_array_equal(read(tmp_path)[1][0], given[0])


def scaled(path, stored, **cards):
    """Write stored integers with a header that scales them."""
    unit = fits.PrimaryHDU(stored)
    unit.writeto(path)
    with fits.open(path, mode='update', do_not_scale_image_data=True) as file:
        file[0].header.update(cards)


@pytest.mark.parametrize(('zero', 'scale'), [(0, 1), (32768, 1), (1000, 0.5), (0, 2)])
@pytest.mark.parametrize('blank', [None, -7])
def test_scaled_numbers_are_scaled_and_blanks_blank(tmp_path, rng, zero, scale, blank):
    stored = rng.integers(-50, 50, SHAPE).astype('i2')
    stored[3, 4] = -7
    cards = {'BZERO': zero, 'BSCALE': scale} | ({} if blank is None else {'BLANK': blank})
    scaled(tmp_path / 'a.fits', stored, **cards)
    found = read(tmp_path)[1][0]
    expected = stored * float(scale) + zero
    if blank is not None:
        expected[stored == blank] = np.nan
    np.testing.assert_array_equal(found, expected)
    assert found.dtype == ('u2' if (zero, scale, blank) == (32768, 1, None) else 'f4')


def test_nan_is_blank(tmp_path, frames):
    given = frames.astype('f4')
    given[:, 0, :5] = np.nan
    fits.writeto(tmp_path / 'a.fits', given)
    reader, found, _ = read(tmp_path)
    np.testing.assert_array_equal(found, given)
    assert '30 pixels of 6 frames' in reader.notes[-1]


def test_files_are_in_the_order_of_their_times_with_their_gaps(tmp_path, frames):
    seconds = [0, 30, 60, 90, 390, 420]
    for k, (frame, second) in enumerate(zip(frames, seconds)):
        fits.PrimaryHDU(frame, dated(second)).writeto(tmp_path / f'{"rg"[k % 2]}_{k}.fits')
    _, found, stamps = read(tmp_path)
    np.testing.assert_array_equal(found, frames)
    assert stamps == [START_S + second for second in seconds]
    reader = open_frames(tmp_path)
    assert [ns for _, ns in reader.stamped(0.5)] == [500_000_000 * k for k in range(1, 7)]


def test_files_with_one_time_need_a_period(tmp_path, frames):
    for k, frame in enumerate(frames):
        fits.PrimaryHDU(frame, dated(k // 2)).writeto(tmp_path / f'{k}.fits')
    assert reason(tmp_path) == 'stamps'
    np.testing.assert_array_equal(
        [frame for frame, _ in open_frames(tmp_path).stamped(0.1)], frames)


def test_files_without_times_among_others_are_said(tmp_path, frames):
    for k, frame in enumerate(frames):
        fits.PrimaryHDU(frame, dated(9 - k) if k else None).writeto(tmp_path / f'{k}.fits')
    reader, found, stamps = read(tmp_path)
    np.testing.assert_array_equal(found, frames)
    assert stamps[:2] == [1.0, 2.0]
    assert '1 of 6 files' in reader.notes[0]


def test_time_axis_of_a_cube_gives_the_stamps(tmp_path, frames):
    header = dated(5, CTYPE3='TIME', CUNIT3='ms', CDELT3=250.0)
    fits.PrimaryHDU(frames, header).writeto(tmp_path / 'a.fits')
    np.testing.assert_allclose(
        read(tmp_path)[2], START_S + 5 + 0.25 * np.arange(6), rtol=0, atol=1e-6)
    fits.PrimaryHDU(frames, dated(5)).writeto(tmp_path / 'a.fits', overwrite=True)
    reader, _, stamps = read(tmp_path)
    assert (stamps[:2], len(reader.notes)) == ([1.0, 2.0], 1)


@pytest.mark.parametrize(('date', 'clock', 'ns'), [
    ('2026-01-01T00:00:00', '', 1_767_225_600 * 10**9),
    ('2026-01-01T00:00:00.123456789', '', 1_767_225_600_123_456_789),
    ('2026-01-01', '00:01:00.5', 1_767_225_660_500_000_000),
    ('31/12/99', '00:00:00', 946_598_400 * 10**9),
    ('2026-01-01', '', None), ('2026-13-01T00:00:00', '', None), ('noon', '', None)])
def test_dates_of_headers(date, clock, ns):
    assert unix_ns(date, clock) == ns


@pytest.mark.parametrize('key', ['MJD-OBS', 'JD'])
def test_days_of_headers(tmp_path, frames, key):
    day = 61_041.25 + (2_400_000.5 if key == 'JD' else 0.0)
    fits.PrimaryHDU(frames[0], fits.Header({key: day})).writeto(tmp_path / 'a.fits')
    assert read(tmp_path)[2] == [START_S + 21_600.0]


def test_gzip_that_is_no_fits_or_unpacks_to_too_much_is_refused(tmp_path, frames, monkeypatch):
    (tmp_path / 'a.fits.gz').write_bytes(gzip.compress(b'no image' * 1000))
    assert reason(tmp_path) == 'unreadable'
    fits.writeto(tmp_path / 'b.fits', frames)
    (tmp_path / 'a.fits.gz').write_bytes(gzip.compress((tmp_path / 'b.fits').read_bytes()))
    monkeypatch.setattr(fits_format, '_MOST_BYTES', 9000)
    assert reason(tmp_path / 'a.fits.gz') == 'too large'
    (tmp_path / 'a.fits.gz').write_bytes((tmp_path / 'a.fits.gz').read_bytes()[:-99])
    monkeypatch.undo()
    assert reason(tmp_path / 'a.fits.gz') == 'unreadable'


def test_compressed_image_that_lies_is_refused_and_the_next_one_read(tmp_path, frames):
    good = tmp_path / 'good.fits'
    unit = fits.CompImageHDU((frames[0] - 32_000).astype('i2'), compression_type='HCOMPRESS_1')
    unit.writeto(good)
    data = good.read_bytes()
    at = data.index(b'\xdd\x99')  # the magic number of a tile, before its size
    lying = tmp_path / 'lying.fits'
    lying.write_bytes(data[:at + 2] + struct.pack('>ii', 30_000, 30_000) + data[at + 10:])
    assert reason(lying) == 'unreadable'
    np.testing.assert_array_equal(read(good)[1][0], frames[0] - 32_000)
