# SPDX-License-Identifier: Apache-2.0
"""A disk that is full."""

import contextlib
from pathlib import Path


def fill(ballast: Path) -> None:
    """Fill the disk that a file is on, to the last byte."""
    with ballast.open('wb', buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(4096))
