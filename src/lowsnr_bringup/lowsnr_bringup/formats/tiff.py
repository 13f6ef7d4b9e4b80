# SPDX-License-Identifier: Apache-2.0
"""TIFF files of one or many pages, at the depth of their pages."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
import logging
import math
from pathlib import Path
import re
from typing import Any

from lowsnr_bringup.bags.errors import UNREADABLE
from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats.bounds import check_frame_size
from lowsnr_bringup.formats.frames import FrameSource
from lowsnr_bringup.formats.frames import library
from lowsnr_bringup.formats.frames import Pixels
from lowsnr_bringup.formats.frames import TimedFrame
from lowsnr_common.settings.text import one_line
import numpy as np

SUFFIXES = ('.tif', '.tiff')
_REDUCED = 1  # bit of NewSubfileType: a smaller copy of another page
_MINISWHITE, _PALETTE = 0, 3


def open_tiff(path: Path, select: str | None = None) -> FrameSource:
    """Return the pages of a TIFF file; of an ImageJ stack also those that it has no pages for."""
    tifffile = library(path, 'tifffile', 'tifffile imagecodecs')
    logging.getLogger('tifffile').setLevel(logging.CRITICAL)
    source = FrameSource(path, lambda: _read(path, tifffile, _frames))
    for count, period_s in _read(path, tifffile, _described):
        source.count, source.period_s = count, period_s
    return source


def _read(path: Path, tifffile: Any, read: Callable[[Path, Any], Iterator[Any]]) -> Iterator[Any]:
    try:
        with tifffile.TiffFile(path) as file:
            yield from read(path, file)
    except UnusableFile:
        raise
    except (*UNREADABLE, tifffile.TiffFileError, ImportError) as error:
        raise UnusableFile(path, 'unreadable', f'not a TIFF image: {one_line(error)}') from None


def _described(path: Path, file: Any) -> Iterator[tuple[int, float | None]]:
    """Yield the number of frames, and the time between them [s] if ImageJ noted it."""
    interval = (file.imagej_metadata or {}).get('finterval') if file.is_imagej else None
    period_s = float(interval) if isinstance(interval, int | float) and interval > 0 else None
    stack = _stack(file)
    if not len(file.pages):
        raise ValueError('has no page')
    yield (stack[0] if stack else sum(1 for _ in _pages(file))), period_s


def _pages(file: Any) -> Iterator[Any]:
    """Yield the pages that are no smaller copies of others."""
    for page in file.pages:
        if not int(getattr(page.aspage(), 'subfiletype', 0) or 0) & _REDUCED:
            yield page.aspage()


def _stack(file: Any) -> tuple[int, int] | None:
    """Return number and offset of frames that follow each other without pages of their own."""
    if not file.is_imagej or len(file.pages) != 1:
        return None
    page = file.pages[0]
    images = int((file.imagej_metadata or {}).get('images') or 1)
    if images < 2 or page.compression != 1 or page.ndim != 2 or not page.dataoffsets:
        return None
    offset = int(page.dataoffsets[0])
    if offset + images * page.size * page.dtype.itemsize > file.filehandle.size:
        raise ValueError(f'declares {images} images and does not hold them')
    return images, offset


def _frames(path: Path, file: Any) -> Iterator[TimedFrame]:
    if stack := _stack(file):
        page = file.pages[0]
        check_frame_size(path, page.shape)
        kind = page.dtype.newbyteorder(file.byteorder)
        file.filehandle.seek(stack[1])
        for _ in range(stack[0]):
            data = file.filehandle.read(page.size * kind.itemsize)
            yield TimedFrame(np.frombuffer(data, kind).reshape(page.shape))
        return
    for page in _pages(file):
        yield TimedFrame(_pixels(path, page))


def _pixels(path: Path, page: Any) -> Pixels:
    """Return the frame that a page is."""
    if page.dtype is None or len(page.shape) < 2 or 0 in page.shape:
        raise ValueError('has a page without pixels of a known kind')
    check_frame_size(path, (page.imagelength, page.imagewidth))
    if math.prod(page.shape) > 4 * page.imagelength * page.imagewidth * max(1, page.imagedepth):
        raise UnusableFile(
            path, 'not frames', f'has a page of shape {page.shape}, which is no grey or colour '
            'image')
    if page.imagedepth > 1:
        raise UnusableFile(
            path, 'not frames', f'has a page of {page.imagedepth} planes, save one page a frame')
    pixels = np.asarray(page.asarray())
    if 'S' in page.axes and page.axes.index('S') == 0:  # colours one after the other
        pixels = np.moveaxis(pixels, 0, -1)
    if page.photometric == _PALETTE and page.colormap is not None:
        pixels = np.moveaxis(np.asarray(page.colormap)[:, pixels], 0, -1)
    elif page.photometric == _MINISWHITE and pixels.dtype.kind == 'b':
        pixels = ~pixels
    elif page.photometric == _MINISWHITE and pixels.dtype.kind == 'u':
        pixels = (2**page.bitspersample - 1 - pixels).astype(pixels.dtype)
    return _blanked(page, pixels)


def _blanked(page: Any, pixels: Pixels) -> Pixels:
    """Return pixels with NaN where they have the value that GDAL declares to be none."""
    tag = page.tags.get('GDAL_NODATA')
    if tag is None or not re.fullmatch(r'\s*[-+]?[\d.]+(e[-+]?\d+)?\s*', str(tag.value), re.I):
        return pixels
    value = float(tag.value)
    return np.where(pixels == value, np.nan, pixels.astype(np.result_type(pixels, np.float32)))
