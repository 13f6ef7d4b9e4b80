"""A file that only grows, and outlives a full disk and its own removal."""

from __future__ import annotations

import os
from pathlib import Path

# What is kept of what cannot be written.
_MOST_WAITING = 2**28
_PIECE = 2**20


class GrowingFile:
    """
    A file that pieces are appended to, each whole and at once.

    What cannot be written, on a full disk, waits in memory and is written before what comes
    next.  Where the file or its folder was removed, or something else stands in its place,
    :meth:`settle` makes it again with all that it held.

    Parameters
    ----------
    path
        The file; its folder exists.
    end
        Where an earlier file goes on [bytes]; what stands behind is cut off.

    Raises
    ------
    OSError
        If it cannot be opened.
    FileExistsError
        If it holds anything already, and ``end`` does not say how much of that is to stay.

    """

    def __init__(self, path: Path, end: int | None = None) -> None:
        self.path = path
        self.lost = 0
        self._waiting = bytearray()
        self._file = path.open('a+b', buffering=0)
        self._written = os.fstat(self._file.fileno()).st_size
        if end is not None:
            self._file.truncate(end)
            self._written = min(end, self._written)
        elif self._written:
            self._file.close()
            raise FileExistsError(0, f'{path.name} holds earlier results')

    @property
    def size(self) -> int:
        """Bytes that the file holds, with what still waits for room."""
        return self._written + len(self._waiting)

    def append(self, piece: bytes) -> None:
        """Write a piece, or keep it until there is room; count it as lost where too many wait."""
        if len(self._waiting) + len(piece) > _MOST_WAITING:
            self.lost += 1
        else:
            self._waiting += piece
        self._write()

    def settle(self) -> str:
        """
        Write what waits, and make the file again where it is gone.

        Returns
        -------
        str
            What is wrong, in words; nothing where all is on disk.

        """
        try:
            if not self._stands():
                self._make_again()
        except OSError as error:
            return f'{self.path}: {error.strerror}'
        trouble = self._write()
        if self._waiting:
            return f'{self.path}: {trouble}; {len(self._waiting)} bytes wait for room'
        return f'{self.path}: {self.lost} pieces were lost for want of room' if self.lost else ''

    def close(self) -> None:
        """Write what can be written, and close the file."""
        self.settle()
        self._file.close()

    def _write(self) -> str:
        """Write what waits as far as there is room; say why not all of it."""
        try:
            while self._waiting:
                count = self._file.write(self._waiting)
                self._written += count
                del self._waiting[:count]
        except OSError as error:
            return str(error.strerror)
        return ''

    def _stands(self) -> bool:
        """Return whether the path still leads to this file."""
        try:
            return os.path.samestat(self.path.stat(), os.fstat(self._file.fileno()))
        except (FileNotFoundError, NotADirectoryError):
            return False

    def _make_again(self) -> None:
        """Write all that the file held into a new one of its name, and go on with that."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        draft = self.path.with_name(f'{self.path.name}.tmp')
        new = draft.open('w+b', buffering=0)
        try:
            self._file.seek(0)
            while piece := self._file.read(_PIECE):
                if new.write(piece) < len(piece):
                    raise OSError(0, 'No space left on device')
            draft.replace(self.path)
        except OSError:
            new.close()
            draft.unlink(missing_ok=True)
            raise
        self._file.close()
        self._file = new
