# SPDX-License-Identifier: Apache-2.0
"""Reading files of frames in tests."""

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats.image_files import open_frames
import numpy as np
import pytest

SHAPE = (24, 32)


def twelve_bit_frames(rng):
    """Return six frames of 12 bits: a level of 1000 with a slope, and noise of 20."""
    scene = 1000.0 + 2.0 * np.arange(SHAPE[1])
    return np.rint(scene + rng.normal(0.0, 20.0, (6, *SHAPE))).astype('u2')


def read(path, **how):
    """Return the reader, its frames as one array, and their stamps [s]."""
    reader = open_frames(path, **how)
    found = list(reader.stamped())
    return reader, np.stack([frame for frame, _ in found]), [ns / 1e9 for _, ns in found]


def reason(path, **how):
    """Return the reason for which frames are refused, in one line that names a file."""
    with pytest.raises(UnusableFile) as caught:
        list(open_frames(path, **how).stamped())
    assert str(caught.value).startswith(f'{caught.value.path}: ')
    assert str(caught.value).isprintable()
    return caught.value.reason
