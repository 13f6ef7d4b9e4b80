"""Images of any camera to arrays: one channel, whatever its depth, byte order and step."""

from __future__ import annotations

from lowsnr_common.core.encodings import LARGEST
from lowsnr_common.core.encodings import pixels_of
from lowsnr_common.core.records import Malformed
import numpy as np
from sensor_msgs.msg import Image


def image_to_array(image: Image) -> np.ndarray:
    """
    Return an image as it is, the luminance of one in colours.

    Returns
    -------
    (rows, cols) ndarray of uint8, uint16 or float32
        Pixels; a view of the message's data where that is possible.

    Raises
    ------
    Malformed
        If encoding, step or size do not fit, or a value is not finite or beyond 1e9; says which.

    """
    frame = pixels_of(image)
    # Of a frame with NaN both are NaN, and compare as false.
    if frame.dtype.kind == 'f' and not (frame.min() >= -LARGEST and frame.max() <= LARGEST):
        row, col = np.argwhere(~(np.abs(frame) <= LARGEST))[0]
        said = 'beyond 1e9' if np.isfinite(frame[row, col]) else 'not a finite number'
        raise Malformed(f'cell {said}', f'cell at row {row}, column {col} is {said}')
    return frame
