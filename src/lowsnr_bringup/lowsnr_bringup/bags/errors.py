# SPDX-License-Identifier: Apache-2.0
"""What goes wrong with files: the error that names one, and all that reading one can raise."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path
import sqlite3
import struct
import tokenize
import zipfile
import zlib

from lowsnr_common.settings.text import printable


def _raised_by_libraries() -> Iterator[type[Exception]]:
    """Yield the errors of the libraries that read bags, of those that are installed."""
    for module, name in (
            ('mcap.exceptions', 'McapError'), ('rosbags.serde', 'SerdeError'),
            ('zstandard', 'ZstdError')):
        with suppress(ModuleNotFoundError):
            yield getattr(import_module(module), name)


# Reading a file that holds arbitrary bytes can raise any of these, in our code and in libraries.
UNREADABLE: tuple[type[Exception], ...] = (
    *_raised_by_libraries(), sqlite3.Error, struct.error, zlib.error,
    tokenize.TokenError, zipfile.BadZipFile, OSError, ValueError, LookupError, TypeError,
    AttributeError, AssertionError, ArithmeticError, MemoryError, RuntimeError, SyntaxError,
    EOFError)


class UnusableFile(ValueError):
    """
    A file or folder cannot be used.

    Parameters
    ----------
    path
        The file or folder.
    reason
        Why, as a code: the same few words for all files with the same fault.
    sentence
        Why, with the values of this file; one line.

    """

    def __init__(self, path: Path, reason: str, sentence: str) -> None:
        super().__init__(printable(f'{path}: {sentence}'))
        self.path = path
        self.reason = reason
        self._sentence = sentence

    def __reduce__(self) -> tuple[type[UnusableFile], tuple[Path, str, str]]:
        """Return what makes the error again in another process."""
        return type(self), (self.path, self.reason, self._sentence)
