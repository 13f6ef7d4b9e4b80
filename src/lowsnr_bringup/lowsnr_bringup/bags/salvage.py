"""Storage files that were cut off or damaged, read as far as they are whole."""

from __future__ import annotations

from collections.abc import Collection
from collections.abc import Iterator
from pathlib import Path
import sqlite3
import struct
from typing import BinaryIO

from rosbags.interfaces import Connection
from rosbags.interfaces import ConnectionExtRosbag2
from rosbags.interfaces import MessageDefinition
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag2 import ReaderError
from rosbags.rosbag2.reader import zstd
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import apsw
from rosbags.serde import SerdeError

# What reading a file that holds anything at all may raise.
BROKEN = (
    ReaderError, SerdeError, apsw.Error, sqlite3.Error, zstd.ZstdError, OSError,
    ValueError, LookupError, TypeError, AttributeError, AssertionError, ArithmeticError,
    MemoryError, RuntimeError, EOFError, struct.error)
MCAP_MAGIC, SQLITE_MAGIC = b'\x89MCAP0\r\n', b'SQLite format 3\0'
# A view may go on for ever.
_TABLES = (
    "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name IN ('topics', 'messages')")
_HEAD = struct.Struct('<BQ')
_HEADER, _LAST = 0x01, (0x00, 0x02, 0x0F)


class SalvagedMcap(McapReader):
    """The records of an MCAP file up to its end or the first one that is not whole."""

    connections: list[Connection]

    def _open(self) -> None:
        starts = _record_starts(self.bio, self.path)
        self.data_start, self.data_end = starts[0], starts[-1]
        try:
            self.meta_scan()
        except BROKEN:
            broken_at = self.bio.tell()
            self.data_end = max(start for start in starts if start < broken_at)
            self.meta_scan()
        counts = self.statistics.channel_message_counts
        self.connections = [
            item._replace(msgcount=counts.get(item.id, 0)) for item in self.connections]


def _record_starts(file: BinaryIO, path: Path) -> list[int]:
    """Return where the whole records start, and where the last of them ends."""
    size = path.stat().st_size
    file.seek(len(MCAP_MAGIC))
    starts: list[int] = []
    while len(head := file.read(_HEAD.size)) == _HEAD.size:
        kind, length = _HEAD.unpack(head)
        end = file.tell() + length
        if end > size or kind in _LAST:
            break
        if not starts and kind != _HEADER:
            raise ReaderError('it does not start with a header')
        starts.append(end)
        file.seek(end)
    if not starts:
        raise ReaderError('its header is not whole')
    return starts


class SalvagedSqlite3:
    """The messages of an SQLite file in the order they were written, up to the damage."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.connections: list[Connection] = []

    def open(self) -> None:  # noqa: A003
        """Read the topics."""
        self._database = sqlite3.connect(f'{self.path.resolve().as_uri()}?mode=ro', uri=True)
        # Without this a file shorter than its own first page says is not read at all.
        self._database.execute('PRAGMA writable_schema = ON')
        (tables,), = self._database.execute(_TABLES)
        if tables != 2:
            raise ReaderError('it has no tables of topics and messages')
        for number, name, msgtype in self._database.execute('SELECT id, name, type FROM topics'):
            self.connections.append(Connection(
                number, name, msgtype, MessageDefinition(MessageDefinitionFormat.NONE, ''), '', 0,
                ConnectionExtRosbag2('cdr', []), self))

    def messages(
        self, connections: Collection[Connection],
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield connection, log time [ns] and data of the messages of some connections."""
        wanted = {item.id: item for item in connections}
        last = 0
        for row, number, logged_ns, data in self._database.execute(
                'SELECT rowid, topic_id, timestamp, data FROM messages NOT INDEXED '
                'ORDER BY rowid'):
            # Of a page that is cut off SQLite takes the rest to be zeros.
            if row <= last or data is None:
                raise ReaderError(f'message {last + 1} is not whole')
            last = row
            if number in wanted:
                yield wanted[number], logged_ns, data

    def close(self) -> None:
        """Close the file."""
        self._database.close()


def roll_back(path: Path) -> None:
    """
    Undo what a killed writer had begun and not completed.

    Raises
    ------
    sqlite3.Error
        If the file cannot be written to.

    """
    if any(path.with_name(f'{path.name}{end}').exists() for end in ('-journal', '-wal')):
        database = sqlite3.connect(path)
        try:
            database.execute('PRAGMA wal_checkpoint(TRUNCATE)').fetchall()
            database.execute('SELECT count(*) FROM sqlite_master').fetchall()
        finally:
            database.close()
