"""Images of any camera to arrays: one channel, whatever its depth, byte order and step."""

from __future__ import annotations

import numpy as np
from sensor_msgs.msg import Image

_KINDS = {'mono8': 'u1', '8UC1': 'u1', 'mono16': 'u2', '16UC1': 'u2', '32FC1': 'f4'}


def image_to_array(image: Image) -> np.ndarray:
    """
    Return an image as it is.

    Returns
    -------
    (rows, cols) ndarray of uint8, uint16 or float32
        Pixels; a view of the message's data.

    Raises
    ------
    ValueError
        If encoding, step or size do not fit, or a value is not finite; says which.

    """
    if image.encoding not in _KINDS:
        raise ValueError(f'encoding is {image.encoding!r}, must be one of {", ".join(_KINDS)}')
    rows, cols, step = image.height, image.width, image.step
    kind = np.dtype(_KINDS[image.encoding]).newbyteorder('>' if image.is_bigendian else '<')
    if rows == 0 or cols == 0:
        raise ValueError(f'frame of {cols} x {rows} cells is empty')
    if step < kind.itemsize * cols:
        raise ValueError(f'step is {step} bytes, must be at least {kind.itemsize * cols}')
    if len(image.data) != rows * step:
        raise ValueError(f'data holds {len(image.data)} bytes, must be {rows * step}')
    frame = np.ndarray((rows, cols), kind, image.data, strides=(step, kind.itemsize))
    if kind.kind == 'f' and not np.isfinite(frame).all():
        row, col = np.argwhere(~np.isfinite(frame))[0]
        raise ValueError(f'cell at row {row}, column {col} is not a finite number')
    return frame
