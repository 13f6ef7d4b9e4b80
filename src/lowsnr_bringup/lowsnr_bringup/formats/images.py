# SPDX-License-Identifier: Apache-2.0
"""PNG, JPEG and BMP images, whose size is known before their pixels are unpacked."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from lowsnr_bringup.bags.compression import MAX_BYTES
from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats.frames import FrameSource
from lowsnr_bringup.formats.frames import TimedFrame
from lowsnr_common.core.records import Malformed
from lowsnr_common.images.compressed import decode_image
from lowsnr_common.settings.text import one_line

SUFFIXES = ('.png', '.jpg', '.jpeg', '.bmp')


def open_image(path: Path, select: str | None = None) -> FrameSource:
    """Return the one frame of an image file."""
    def frames() -> Iterator[TimedFrame]:
        try:
            yield TimedFrame(decode_image(read_bytes(path)))
        except Malformed as error:
            raise UnusableFile(path, error.reason, str(error)) from None
    return FrameSource(path, frames, 1)


def read_bytes(path: Path) -> bytes:
    """Return the content of a file that is read at once; UnusableFile if it is too large."""
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise UnusableFile(
                path, 'too large', f'an image of {size} bytes, at most {MAX_BYTES} are read')
        return path.read_bytes()
    except OSError as error:
        raise UnusableFile(path, 'unreadable', f'not an image: {one_line(error)}') from None
