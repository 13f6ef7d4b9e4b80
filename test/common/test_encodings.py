# SPDX-License-Identifier: Apache-2.0
"""Images of every encoding become one channel at their depth, or are rejected by name."""

from types import SimpleNamespace

import cv2
from lowsnr_common.core.records import Malformed
from lowsnr_common.images.image_encodings import check_image
from lowsnr_common.images.image_encodings import ENCODINGS
from lowsnr_common.images.image_encodings import pixels_of
import numpy as np
import pytest

ROWS, COLS = 6, 8


def image(pixels, encoding, *, big=False, padding=0, extra=b''):
    """Return an image message of an array (rows, cols[, channels])."""
    kind = pixels.dtype.newbyteorder('>' if big else '<')
    rows = pixels.astype(kind).reshape(len(pixels), -1).view('u1')
    rows = np.pad(rows, ((0, 0), (0, padding)))
    return SimpleNamespace(
        height=pixels.shape[0], width=pixels.shape[1], encoding=encoding, is_bigendian=big,
        step=rows.shape[1], data=rows.tobytes() + extra)


@pytest.mark.parametrize('big', [False, True])
@pytest.mark.parametrize(('encoding', 'kind', 'found'), [
    ('mono8', 'u1', 'u1'), ('8UC1', 'u1', 'u1'), ('8SC1', 'i1', 'f4'), ('mono16', 'u2', 'u2'),
    ('16UC1', 'u2', 'u2'), ('16SC1', 'i2', 'f4'), ('32SC1', 'i4', 'f4'), ('32FC1', 'f4', 'f4'),
    ('64FC1', 'f8', 'f4')])
def test_grey(rng, encoding, kind, found, big):
    pixels = rng.integers(-99 if kind[0] != 'u' else 0, 99, (ROWS, COLS)).astype(kind)
    array = pixels_of(image(pixels, encoding, big=big, padding=3))
    np.testing.assert_array_equal(array, pixels)
    assert array.dtype.newbyteorder('=') == found


@pytest.mark.parametrize('encoding', [
    'rgb8', 'bgr8', 'rgba8', 'bgra8', 'rgb16', 'bgr16', 'rgba16', 'bgra16', '8UC3', '16UC3'])
def test_colours_become_luminance(rng, encoding):
    kind, channels = ('u2' if '16' in encoding else 'u1'), 4 if 'a' in encoding else 3
    pixels = rng.integers(0, 255, (ROWS, COLS, channels)).astype(kind)
    weights = np.array([0.299, 0.587, 0.114, 0.0])[:channels]
    if not encoding.startswith('rgb'):
        weights[[0, 2]] = weights[[2, 0]]
    array = pixels_of(image(pixels, encoding, padding=4))
    np.testing.assert_allclose(array, pixels @ weights, atol=0.51)
    assert array.dtype == kind
    np.testing.assert_array_equal(  # grey in colours keeps its numbers
        pixels_of(image(np.repeat(pixels[..., :1], channels, 2), encoding)), pixels[..., 0])


@pytest.mark.parametrize(('encoding', 'luma'), [
    ('yuv422', 1), ('uyvy', 1), ('yuv422_yuy2', 0), ('yuyv', 0)])
def test_luminance_of_packed_yuv(rng, encoding, luma):
    pixels = rng.integers(0, 255, (ROWS, COLS, 2)).astype('u1')
    np.testing.assert_array_equal(pixels_of(image(pixels, encoding)), pixels[..., luma])


@pytest.mark.parametrize(('encoding', 'more'), [('nv12', 0.5), ('nv21', 0.5), ('nv24', 2)])
def test_luminance_of_planes(rng, encoding, more):
    pixels = rng.integers(0, 255, (ROWS, COLS)).astype('u1')
    planes = bytes(int(more * pixels.size))
    np.testing.assert_array_equal(pixels_of(image(pixels, encoding, extra=planes)), pixels)


@pytest.mark.parametrize('order', ['rggb', 'bggr', 'gbrg', 'grbg'])
@pytest.mark.parametrize('bits', [8, 16])
def test_luminance_of_a_mosaic(order, bits):
    colour = {'r': 200, 'g': 100, 'b': 20}
    tile = np.array([colour[each] for each in order]).reshape(2, 2)
    pixels = np.tile(tile, (ROWS // 2, COLS // 2)).astype(f'u{bits // 8}')
    array = pixels_of(image(pixels, f'bayer_{order}{bits}', big=bits == 16))
    expected = cv2.cvtColor(np.uint8([[[200, 100, 20]]]), cv2.COLOR_RGB2GRAY).item()
    np.testing.assert_allclose(array[1:-1, 1:-1], expected, atol=1)


@pytest.mark.parametrize(('changed', 'reason'), [
    ({'encoding': 'jpeg'}, 'wrong encoding'), ({'encoding': '32FC3'}, 'wrong encoding'),
    ({'encoding': ''}, 'wrong encoding'), ({'height': 0}, 'empty frame'),
    ({'step': COLS - 1}, 'wrong step'), ({'data': b'short'}, 'wrong size')])
@pytest.mark.parametrize('check', [check_image, pixels_of])
def test_what_does_not_fit_is_rejected(changed, reason, check):
    message = image(np.zeros((ROWS, COLS), 'u1'), 'mono8')
    vars(message).update(changed)
    with pytest.raises(Malformed) as caught:
        check(message)
    assert caught.value.reason == reason
    assert str(caught.value).isprintable()


def test_every_encoding_has_a_name_once():
    assert len(set(ENCODINGS)) == len(ENCODINGS)
