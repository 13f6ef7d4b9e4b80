"""Compressed parts of bags, unpacked no further than they say and memory may bear."""

from __future__ import annotations

from lz4.frame import LZ4FrameDecompressor
from rosbags.rosbag2 import ReaderError
from rosbags.rosbag2 import storage_mcap
from rosbags.rosbag2.reader import zstd

# The largest part of a bag that is unpacked at once: several times the largest frame.
_MOST_BYTES = 2**30
_DECOMPRESSORS = {'lz4': LZ4FrameDecompressor, 'zstd': zstd.ZstdDecompressor}


def unpacked(data: bytes, size: int = _MOST_BYTES, kind: str = 'zstd') -> bytes:
    """
    Return what was compressed.

    Parameters
    ----------
    data
        The whole of it.
    size
        The most bytes that it may be.
    kind
        ``'zstd'`` or ``'lz4'``.

    Raises
    ------
    ReaderError
        If it is larger, or not whole.

    """
    if size > _MOST_BYTES:
        raise ReaderError(f'a part of {size} bytes, at most {_MOST_BYTES} are unpacked')
    decompressor = _DECOMPRESSORS[kind]()
    plain: bytes = decompressor.decompress(data, max_length=size + 1)
    if len(plain) > size:
        raise ReaderError(f'a part that unpacks to more than {size} bytes')
    if not decompressor.eof:
        raise ReaderError('a compressed part is not whole')
    return plain


# The library itself unpacks whatever there is, a terabyte of zeros too.
storage_mcap.DECOMPRESSORS.update({
    'lz4': lambda data, size: unpacked(data, size, 'lz4'),
    'zstd': lambda data, size: unpacked(data, size, 'zstd')})
