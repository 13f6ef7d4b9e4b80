# SPDX-License-Identifier: Apache-2.0
"""A file that only grows, and survives a full disk and its own removal."""

from __future__ import annotations

from dataclasses import dataclass
import errno
import os
from pathlib import Path

# Bytes that are kept in memory at most while they cannot be written.
_MOST_WAITING = 2**28
_PIECE = 2**20


@dataclass(frozen=True)
class WriteFault:
    """
    Why a file does not hold all that was appended to it.

    ``error`` is that of the system, None where all waiting bytes were written; ``waiting`` counts
    the bytes that wait in memory, ``lost`` the pieces that were dropped as too many waited.
    """

    path: Path
    error: OSError | None
    waiting: int
    lost: int

    @property
    def full(self) -> bool:
        """Whether the disk, or the user's share of it, is full."""
        return self.error is not None and self.error.errno in (errno.ENOSPC, errno.EDQUOT)

    def __str__(self) -> str:
        """Return the fault in one line."""
        parts = [self.error.strerror or 'it cannot be written'] if self.error else []
        parts += [f'{self.waiting} bytes wait for room'] * (self.waiting > 0)
        parts += [f'{self.lost} pieces were lost'] * (self.lost > 0)
        return f'{self.path}: {"; ".join(parts)}'


class GrowingFile:
    """
    A file to which pieces are appended, each whole and at once.

    A piece that cannot be written, on a full disk, waits in memory and is written before the
    next one.  Where the file or its folder was removed or replaced, :meth:`flush` recreates the
    file with all that it held.

    Parameters
    ----------
    path
        The file; its folder exists.
    end
        Size at which an earlier file continues [bytes]; what follows is cut off.

    Raises
    ------
    OSError
        If the file cannot be opened.
    FileExistsError
        If the file is not empty and ``end`` is None.

    """

    def __init__(self, path: Path, end: int | None = None) -> None:
        self.path = path
        self._lost = 0
        self._waiting = bytearray()
        self._file = path.open('a+b', buffering=0)
        self._written = os.fstat(self._file.fileno()).st_size
        if end is not None:
            self._file.truncate(end)
            self._written = min(end, self._written)
        elif self._written:
            self._file.close()
            raise FileExistsError(errno.EEXIST, f'{path.name} holds earlier results')

    @property
    def size(self) -> int:
        """Bytes that the file holds, with those that wait for room."""
        return self._written + len(self._waiting)

    def append(self, piece: bytes) -> None:
        """Write a piece, or keep it until there is room; drop it where too many wait."""
        if len(self._waiting) + len(piece) > _MOST_WAITING:
            self._lost += 1
        else:
            self._waiting += piece
        self._write()

    def flush(self) -> WriteFault | None:
        """Write what waits, and recreate the file where it is gone; return what is wrong."""
        try:
            if not self._exists():
                self._recreate()
            error = self._write()
        except OSError as found:
            error = found
        if error is None and not self._lost:
            return None
        return WriteFault(self.path, error, len(self._waiting), self._lost)

    def give_way(self) -> None:
        """Give the room that the file takes to others: it is empty from now on."""
        self._waiting.clear()
        self._file.truncate(0)
        self._written = 0

    def close(self) -> None:
        """Write what can be written, and close the file."""
        self.flush()
        self._file.close()

    def _write(self) -> OSError | None:
        """Write what waits as far as there is room; return why not all of it."""
        try:
            while self._waiting:
                count = self._file.write(self._waiting)
                self._written += count
                del self._waiting[:count]
        except OSError as error:
            return error
        return None

    def _exists(self) -> bool:
        """Return whether the path still leads to this file."""
        try:
            return os.path.samestat(self.path.stat(), os.fstat(self._file.fileno()))
        except (FileNotFoundError, NotADirectoryError):
            return False

    def _recreate(self) -> None:
        """Write all that the file held into a new one of its name, and continue with that."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        draft = self.path.with_name(f'{self.path.name}.tmp')
        new = draft.open('w+b', buffering=0)
        try:
            self._file.seek(0)
            while piece := self._file.read(_PIECE):
                if new.write(piece) < len(piece):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            draft.replace(self.path)
        except OSError:
            new.close()
            draft.unlink(missing_ok=True)
            raise
        self._file.close()
        self._file = new
