# SPDX-License-Identifier: Apache-2.0
"""Films are read frame by frame: the memory that it takes does not grow with their length."""

import struct
import tracemalloc

from astropy.io import fits
import av
import imagecodecs  # noqa: F401  (here, so that its memory does not count)
from lowsnr_bringup.formats.image_files import open_frames
import numpy as np
import pytest
import tifffile

MIB = 2**20
FRAMES, SHAPE = 24, (1024, 1024)


def write(path, frames):
    """Write a film of 8 bits in the format of the file's ending."""
    ending = path.name.partition('.')[2]
    if ending == 'tif':
        tifffile.imwrite(path, frames, photometric='minisblack')
    elif ending == 'fits':
        fits.writeto(path, frames)
    elif ending == 'npy':
        np.save(path, frames)
    elif ending == 'ser':
        head = struct.pack('<14s7i120s2q', b'LUCAM-RECORDER', 0, 0, 0, SHAPE[1], SHAPE[0], 8,
                           len(frames), b'', 0, 0)
        path.write_bytes(head + frames.tobytes())
    else:
        with av.open(str(path), 'w') as container:
            stream = container.add_stream('ffv1', rate=10)
            stream.width, stream.height, stream.pix_fmt = SHAPE[1], SHAPE[0], 'gray'
            for frame in frames:
                container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, 'gray')))
            container.mux(stream.encode(None))


@pytest.mark.parametrize('ending', ['tif', 'fits', 'npy', 'ser', 'mkv'])
def test_long_film_takes_the_memory_of_a_few_frames(tmp_path, ending):
    path = tmp_path / f'a.{ending}'
    write(path, np.broadcast_to(np.arange(FRAMES, dtype='u1')[:, None, None], (FRAMES, *SHAPE)))
    next(iter(open_frames(path)))  # imports
    tracemalloc.start()
    try:
        means = [int(frame[0, 0]) for frame in open_frames(path)]
        assert tracemalloc.get_traced_memory()[1] < 12 * MIB
    finally:
        tracemalloc.stop()
    assert means == list(range(FRAMES))
