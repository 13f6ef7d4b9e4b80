"""Images of ``sensor_msgs/CompressedImage``: PNG and JPEG; other ways are refused by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats.images import decode_image
from lowsnr_common.core.encodings import luminance
from lowsnr_common.core.records import Malformed
import numpy as np


def decode_compressed(message: Any) -> np.ndarray:
    """
    Return the pixels of a compressed image.

    Parameters
    ----------
    message
        Has the fields ``format``, such as ``mono16; png compressed``, and ``data``.

    Returns
    -------
    (rows, cols) ndarray of uint8 or uint16
        Pixels, the luminance of colours.

    Raises
    ------
    Malformed
        If the format is not PNG or JPEG, or the data are not what it says.

    """
    how = message.format.lower()
    if 'compresseddepth' in how or not any(kind in how for kind in ('png', 'jpeg', 'jpg')):
        raise Malformed(
            'wrong encoding', f'format is {message.format[:40]!r}, must be png or jpeg')
    try:
        pixels = luminance(decode_image(Path('image'), bytes(message.data)))
    except UnusableFile as error:
        raise Malformed(f'{error.reason} image', str(error).removeprefix('image: ')) from None
    if pixels.dtype not in (np.uint8, np.uint16):
        raise Malformed('wrong encoding', f'its pixels are {pixels.dtype}, must be 8 or 16 bits')
    return pixels
