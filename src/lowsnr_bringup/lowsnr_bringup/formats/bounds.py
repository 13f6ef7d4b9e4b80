"""The largest frame that is read: a small file can declare, or unpack to, gigabytes."""

from __future__ import annotations

import math
from pathlib import Path

from lowsnr_bringup.bags.errors import UnusableFile

MOST_PIXELS = 2**26  # 8192 x 8192


def check_frame_size(path: Path, shape: tuple[int, ...]) -> None:
    """Raise UnusableFile with reason ``too large`` for a frame of more than ``MOST_PIXELS``."""
    if math.prod(shape) > MOST_PIXELS:
        raise UnusableFile(
            path, 'too large', f'a frame of {" x ".join(map(str, shape[::-1]))} pixels, at most '
            f'{MOST_PIXELS} pixels are read')
