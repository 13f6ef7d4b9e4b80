# SPDX-License-Identifier: Apache-2.0
"""Compressed parts of bags, unpacked to no more bytes than they declare."""

from __future__ import annotations

import errno
import os
from pathlib import Path
import shutil

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_common.settings.text import one_line
from lz4.frame import LZ4FrameDecompressor
import zstandard

# The largest part of a bag that is held in memory: several times the largest frame.
MAX_BYTES = 2**30
_BLOCK_BYTES = 2**20
# What stays free of a disk on which a bag is unpacked, for others that need it.
_RESERVED_BYTES = 2**26


def unpack(data: bytes, size: int, kind: str) -> bytes:
    """
    Unpack a chunk of known size.

    The libraries' own functions take as much memory as the data ask for, which may be a terabyte.

    Parameters
    ----------
    data
        The compressed bytes.
    size
        Number of bytes that they unpack to.
    kind
        ``'zstd'``, ``'lz4'`` or ``''`` for data that are not compressed.

    Raises
    ------
    ValueError, zstandard.ZstdError, RuntimeError
        If the data are damaged, or unpack to another number of bytes or more than 1 GiB.

    """
    if not 0 <= size <= MAX_BYTES:
        raise ValueError(f'a part of {size} bytes, at most {MAX_BYTES} bytes are unpacked')
    if kind == 'zstd':
        plain = zstandard.ZstdDecompressor().stream_reader(data).read(size + 1)
    elif kind == 'lz4':
        plain = LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    elif kind:
        raise ValueError(f'compression {kind!r} is not known')
    else:
        plain = data
    if len(plain) != size:
        raise ValueError(f'a part does not hold the {size} bytes that it declares')
    return plain


def unpack_message(data: bytes) -> bytes:
    """Unpack a message that was compressed by itself; raises as :func:`unpack`."""
    return unpack(data, zstandard.frame_content_size(data), 'zstd')


def unpack_file(source: Path, target: Path) -> str:
    """
    Unpack a compressed file as far as possible; return what is wrong, or ``''``.

    Raises
    ------
    UnusableFile
        With reason ``no room``, if it unpacks to more than the disk of the target has free.

    """
    room = shutil.disk_usage(target.parent).free - _RESERVED_BYTES
    try:
        with source.open('rb') as packed, target.open('wb') as plain:
            stream = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
            while block := stream.read(_BLOCK_BYTES):
                if plain.tell() + len(block) > room:
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                plain.write(block)
    except (zstandard.ZstdError, OSError) as error:
        if getattr(error, 'errno', None) == errno.ENOSPC:
            raise UnusableFile(
                source, 'no room', f'unpacks to more than the {max(0, room)} bytes that may be '
                f'used in {target.parent}; set TMPDIR to a folder with more') from None
        return one_line(error)
    return ''
