# SPDX-License-Identifier: Apache-2.0
"""Pixels of images as ``sensor_msgs/Image`` encodes them: one channel of each, at its depth."""

from __future__ import annotations

from typing import Any
from typing import Protocol

from lowsnr_common.core.records import Malformed
import numpy as np

# Numbers beyond it are no intensities; squared and summed up they still are finite.
LARGEST = 1e9
MONO = {
    'mono8': 'u1', '8UC1': 'u1', '8SC1': 'i1', 'mono16': 'u2', '16UC1': 'u2', '16SC1': 'i2',
    '32SC1': 'i4', '32FC1': 'f4', '64FC1': 'f8'}
# Colours: type of a channel, number of channels, whether blue is the first.
_COLOURS = {
    f'{order}{alpha}{bits}': (f'u{bits // 8}', 3 + len(alpha), order == 'bgr')
    for order in ('rgb', 'bgr') for alpha in ('', 'a') for bits in (8, 16)} | {
        f'{bits}UC{channels}': (f'u{bits // 8}', channels, True)
        for bits in (8, 16) for channels in (3, 4)}
# Bytes of a pixel, and the first byte of luminance; planes of colour may follow the rows.
_YUV = {
    'yuv422': (2, 1), 'uyvy': (2, 1), 'yuv422_yuy2': (2, 0), 'yuyv': (2, 0),
    'nv12': (1, 0), 'nv21': (1, 0), 'nv24': (1, 0)}
_PLANES = {'nv12': 1.5, 'nv21': 1.5, 'nv24': 3.0}  # in parts of the plane of luminance
_BAYER = {
    f'bayer_{order}{bits}': (f'u{bits // 8}', order.upper())
    for order in ('rggb', 'bggr', 'gbrg', 'grbg') for bits in (8, 16)}
ENCODINGS = (*MONO, *_COLOURS, *_YUV, *_BAYER)


class EncodedImage(Protocol):
    """The fields of ``sensor_msgs/Image``."""

    height: int
    width: int
    encoding: str
    is_bigendian: Any
    step: int
    data: Any


def pixels_of(image: EncodedImage) -> np.ndarray:
    """
    Return the pixels of an image, the luminance of colours.

    Returns
    -------
    (rows, cols) ndarray of uint8, uint16 or float32
        A view of the message's data where that is possible.

    Raises
    ------
    Malformed
        If encoding, step or size do not fit; says which.

    """
    raw, name = numbers_of(image), image.encoding
    if name in _COLOURS:
        return luminance(raw[..., [2, 1, 0]] if _COLOURS[name][2] else raw)
    if name in _YUV:
        return raw[..., _YUV[name][1]]
    if name in _BAYER:
        import cv2  # slow to import
        native = np.ascontiguousarray(raw.astype(raw.dtype.newbyteorder('=')))
        return np.asarray(cv2.cvtColor(native, getattr(
            cv2, f'COLOR_Bayer{_BAYER[name][1]}2GRAY')))
    if raw.dtype.kind == 'u' or raw.dtype.str[1:] == 'f4':
        return raw
    with np.errstate(over='ignore'):
        return raw.astype(np.float32)


def check_image(image: EncodedImage) -> None:
    """Raise Malformed as :func:`pixels_of` does."""
    numbers_of(image)


def is_whole(frame: np.ndarray) -> bool:
    """Return whether every pixel has a value: of a frame with NaN no comparison is true."""
    # As numbers of Python: the bound itself is infinite in 16 bits.
    return frame.dtype.kind != 'f' or (
        float(frame.min()) >= -LARGEST and float(frame.max()) <= LARGEST)


def numbers_of(image: EncodedImage) -> np.ndarray:
    """Return the data as (rows, cols) or (rows, cols, channels), as they are encoded, checked."""
    kind, channels = _layout(image.encoding)
    rows, cols, step = image.height, image.width, image.step
    kind = kind.newbyteorder('>' if image.is_bigendian else '<')
    if rows == 0 or cols == 0:
        raise Malformed('empty frame', f'frame of {cols} x {rows} cells is empty')
    pixel = kind.itemsize * max(1, channels)
    if step < pixel * cols:
        raise Malformed('wrong step', f'step is {step} bytes, must be at least {pixel * cols}')
    size = int(rows * step * _PLANES.get(image.encoding, 1.0))
    if len(image.data) != size:
        raise Malformed('wrong size', f'data holds {len(image.data)} bytes, must be {size}')
    if not channels:
        return np.ndarray((rows, cols), kind, image.data, strides=(step, pixel))
    return np.ndarray(
        (rows, cols, channels), kind, image.data, strides=(step, pixel, kind.itemsize))


def _layout(encoding: str) -> tuple[np.dtype[Any], int]:
    """Return the type of a number, and how many each pixel has; 0 for one without an axis."""
    if encoding in MONO:
        return np.dtype(MONO[encoding]), 0
    if encoding in _BAYER:
        return np.dtype(_BAYER[encoding][0]), 0
    if encoding in _COLOURS:
        kind, channels, _ = _COLOURS[encoding]
        return np.dtype(kind), channels
    if encoding in _YUV:
        return np.dtype('u1'), _YUV[encoding][0]
    raise Malformed(
        'wrong encoding',
        f'encoding is {encoding[:40]!r}, must be one of {", ".join(ENCODINGS)}')


def luminance(pixels: np.ndarray) -> np.ndarray:
    """
    Return one channel of a frame: grey, or the luminance of its colours (ITU-R BT.601).

    Parameters
    ----------
    pixels : (rows, cols) or (rows, cols, channels) ndarray
        Channels are grey and perhaps alpha, or red, green, blue and perhaps alpha.

    """
    if pixels.ndim != 3 or pixels.shape[2] not in (1, 2, 3, 4):
        return pixels
    if pixels.shape[2] < 3 or (pixels[..., :3] == pixels[..., :1]).all():
        return pixels[..., 0]
    import cv2  # slow to import
    small = pixels.dtype.kind == 'u' and pixels.itemsize <= 2
    native = pixels[..., :3].astype(pixels.dtype.newbyteorder('=') if small else np.float32)
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(native), cv2.COLOR_RGB2GRAY))
