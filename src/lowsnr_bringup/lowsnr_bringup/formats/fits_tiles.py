# SPDX-License-Identifier: Apache-2.0
"""
Compressed FITS images, unpacked by a process of their own.

The compiled code that unpacks tiles believes what they declare, and a false one can make it write
beyond its memory.  Here that ends a process which holds nothing else, with bounds of memory and
time, and the file is named.
"""

from __future__ import annotations

import atexit
from contextlib import suppress
import json
import os
from pathlib import Path
import resource
import selectors
import subprocess
import sys
from typing import Any
from typing import IO

from lowsnr_bringup.bags.errors import UNREADABLE
from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats.frames import Pixels
from lowsnr_common.images.compressed import MOST_PIXELS
import numpy as np

# Of the process, with the libraries that it maps; a frame of 2**26 pixels takes a third of it.
_MOST_MEMORY = 2**32
_WITHIN_S = 60.0  # of one frame
_MOST_ITEM = 8
_running: list[subprocess.Popen[bytes]] = []


def unpacked_plane(path: Path, plain: Path, index: int, plane: int) -> Pixels:
    """
    Return a plane (rows, cols) of a compressed image.

    Parameters
    ----------
    path, plain
        The file to name in errors, and the file to read.
    index, plane
        Number of the image in the file, and of the plane in the image, from 0.

    Raises
    ------
    UnusableFile
        With reason ``unreadable``, if it cannot be unpacked within the bounds.

    """
    process = _process()
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        process.stdin.write(json.dumps([str(plain), index, plane]).encode() + b'\n')
        process.stdin.flush()
        _wait(process.stdout)
        head = json.loads(process.stdout.readline())
        if 'error' in head:
            raise UnusableFile(path, 'unreadable', f'not a FITS image: {head["error"]}')
        kind, shape = np.dtype(head['kind']), tuple(head['shape'])
        size = int(np.prod(shape)) * kind.itemsize
        if kind.kind not in 'iuf' or not 0 <= size <= _MOST_ITEM * MOST_PIXELS:
            raise ValueError
        data = process.stdout.read(size)
        return np.frombuffer(data, kind).reshape(shape)
    except (OSError, ValueError, LookupError, TypeError) as error:
        if isinstance(error, UnusableFile):
            raise
        _stop()
        raise UnusableFile(
            path, 'unreadable', 'its compressed image is damaged: it cannot be unpacked within '
            f'{_WITHIN_S:g} s and {_MOST_MEMORY // 2**30} GiB of memory') from None


def _process() -> subprocess.Popen[bytes]:
    """Return the process that unpacks, which serves all files."""
    if _running and _running[0].poll() is not None:
        _stop()
    if not _running:
        environment = os.environ | {
            'PYTHONPATH': os.pathsep.join(filter(None, sys.path)), 'OPENBLAS_NUM_THREADS': '1'}
        _running.append(subprocess.Popen(
            [sys.executable, '-m', __name__], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, env=environment))
    return _running[0]


@atexit.register
def _stop() -> None:
    while _running:
        process = _running.pop()
        process.kill()
        process.wait()
        for pipe in (process.stdin, process.stdout):
            assert pipe is not None
            with suppress(OSError):  # what was not written
                pipe.close()


def _wait(pipe: IO[bytes]) -> None:
    """Wait until an answer begins; ValueError if it does not."""
    with selectors.DefaultSelector() as selector:
        selector.register(pipe, selectors.EVENT_READ)
        if not selector.select(_WITHIN_S):
            raise ValueError


def _serve() -> None:
    """Answer requests on the standard input until it is closed."""
    from astropy.io import fits
    from lowsnr_bringup.formats.fits import plane_of
    from lowsnr_common.settings.text import one_line

    resource.setrlimit(resource.RLIMIT_AS, (_MOST_MEMORY, _MOST_MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    units: Any = None
    opened = ''
    for line in sys.stdin.buffer:
        name, index, plane = json.loads(line)
        try:
            if name != opened:
                units, opened = fits.open(name, memmap=False), name
            pixels = np.ascontiguousarray(plane_of(units[index], plane))
            head = {'kind': pixels.dtype.str, 'shape': pixels.shape}
        except (*UNREADABLE, fits.VerifyError) as error:
            head, pixels = {'error': one_line(error) or type(error).__name__}, np.zeros(0)
        sys.stdout.buffer.write(json.dumps(head).encode() + b'\n')
        if 'error' not in head:
            sys.stdout.buffer.write(pixels.tobytes())
        sys.stdout.buffer.flush()


if __name__ == '__main__':
    _serve()
