# SPDX-License-Identifier: Apache-2.0
"""The largest frame that is read: a small file can declare, or unpack to, gigabytes."""

from __future__ import annotations

import math
from pathlib import Path

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_common.images.compressed import MOST_PIXELS


def check_frame_size(path: Path, shape: tuple[int, ...]) -> None:
    """Raise UnusableFile with reason ``too large`` for a frame of more than ``MOST_PIXELS``."""
    if math.prod(shape) > MOST_PIXELS:
        raise UnusableFile(
            path, 'too large', f'a frame of {" x ".join(map(str, shape[::-1]))} pixels, at most '
            f'{MOST_PIXELS} pixels are read')
