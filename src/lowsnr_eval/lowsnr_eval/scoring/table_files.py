# SPDX-License-Identifier: Apache-2.0
"""The files of tables: opened for appending with their header, and read line by line."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
import csv
import mmap
from pathlib import Path
from typing import TypeVar

from lowsnr_bringup.run import results_folder as files
from lowsnr_bringup.run.growing_file import GrowingFile
from lowsnr_eval.scoring import score_rows as rows

T = TypeVar('T')


def open_table(path: Path, columns: Sequence[str], end: int | None) -> GrowingFile:
    """Open a table, with its header."""
    try:
        file = GrowingFile(path, end)
    except OSError as error:
        raise files.cannot_write(path.parent, error) from None
    if file.size == 0:
        file.append(rows.as_lines([columns]))
    return file


def lines_of(path: Path, columns: Sequence[str]) -> Iterator[bytes]:
    """Yield the lines after the header; a last one that was cut off is left out."""
    with path.open('rb') as file:
        _check_header(path, file.readline(), columns)
        for line in file:
            if line.endswith(b'\n'):
                yield line


def lines_backwards(path: Path, columns: Sequence[str]) -> Iterator[tuple[int, bytes]]:
    """Yield the whole lines after the header, the last first, and where each ends [bytes]."""
    if not path.is_file() or not path.stat().st_size:
        return
    with path.open('rb') as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        first = data.readline()
        _check_header(path, first, columns)
        stop = data.rfind(b'\n') + 1
        while stop > len(first):
            start = data.rfind(b'\n', 0, stop - 1) + 1
            yield stop, data[start:stop]
            stop = start


def _check_header(path: Path, line: bytes, columns: Sequence[str]) -> None:
    """Raise ValueError where the first line is neither the header nor its cut-off beginning."""
    if not rows.as_lines([columns]).startswith(line):
        raise ValueError(f'{path}: its first line is not {",".join(columns)}')


def parsed(path: Path, line: bytes, parse: Callable[[bytes], T]) -> T:
    """Return what a line holds; ValueError names the file where it is none of this table."""
    try:
        return parse(line)
    except (ValueError, csv.Error):
        raise ValueError(f'{path}: {line[:200]!r} is not a line of this table') from None
