# SPDX-License-Identifier: Apache-2.0
"""
SQLite storage files, by the standard library, with the tables of rosbag2.

The writer of ``rosbags`` commits once, at its end, so that a killed recorder would leave nothing.
"""

from __future__ import annotations

from collections.abc import Collection
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
import sqlite3

from lowsnr_bringup.bags.errors import UNREADABLE
from lowsnr_bringup.bags.storage import METADATA_VERSION
from lowsnr_bringup.bags.storage import ROS_DISTRO
from lowsnr_bringup.bags.storage import StoredMessage
from lowsnr_bringup.bags.storage import Topic
from lowsnr_common.settings.text import one_line

MAGIC = b'SQLite format 3\0'
_SCHEMA = f"""
PRAGMA page_size = 65536;  -- writes large frames faster
PRAGMA synchronous = OFF;  -- a commit outlasts the process; waiting for the disk loses frames
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(
  id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
CREATE TABLE topics(
  id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
  serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL,
  type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(
  id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
  encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(
  id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
  data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
INSERT INTO schema(schema_version, ros_distro) VALUES (4, '{ROS_DISTRO}');
"""
# A view in place of a table could yield rows without end.
_TABLES = (
    "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name IN ('topics', 'messages')")
_ALL_PAGES = 'SELECT topic_id, count(*) FROM messages NOT INDEXED GROUP BY topic_id'
_IN_TIME_ORDER = (
    'SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({}) ORDER BY timestamp')
_AS_WRITTEN = (
    'SELECT rowid, topic_id, timestamp, data FROM messages NOT INDEXED ORDER BY rowid')


class SqliteStorageWriter:
    """
    Writer of an SQLite file; see :class:`~lowsnr_bringup.bags.storage.StorageWriter`.

    A full disk raises sqlite3.Error too.  The tables have no place for publish times.
    """

    def __init__(self, path: Path) -> None:
        self._database = sqlite3.connect(path)
        self._database.executescript(_SCHEMA)
        self._msgtypes: set[str] = set()

    def add_topic(self, topic: Topic, definition: str, qos: str) -> None:
        """Add a topic with the definition of its type and its quality of service as YAML."""
        if topic.msgtype not in self._msgtypes:
            self._msgtypes.add(topic.msgtype)
            self._database.execute(
                'INSERT INTO message_definitions VALUES (NULL, ?, ?, ?, ?)',
                (topic.msgtype, 'ros2msg', definition, topic.digest))
        self._database.execute(
            'INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)',
            (topic.number, topic.name, topic.msgtype, 'cdr', qos, topic.digest))

    def write(self, number: int, data: bytes, logged_ns: int, published_ns: int) -> None:
        """Write a message of the topic with this number."""
        self._database.execute(
            'INSERT INTO messages VALUES (NULL, ?, ?, ?)', (number, logged_ns, data))

    def flush(self) -> None:
        """Hand all messages to the operating system: they outlast the process."""
        self._database.commit()

    def close(self, metadata: str) -> None:
        """Write the metadata of the bag, and close the file."""
        self._database.execute(
            'INSERT INTO metadata VALUES (NULL, ?, ?)', (METADATA_VERSION, metadata))
        self._database.commit()
        self._database.close()

    def abort(self) -> None:
        """Close the file as it was at the last ``flush``."""
        try:
            self._database.rollback()
        finally:
            self._database.close()


class SqliteStorageReader:
    """
    Reader of an SQLite file; see :class:`~lowsnr_bringup.bags.storage.StorageReader`.

    Raises
    ------
    UNREADABLE
        If not even the topics of the file can be read.

    """

    def __init__(self, path: Path) -> None:
        self.damage = ''
        self.topics: list[Topic] = []
        try:
            _complete(path)
            self._open(path)
        except UNREADABLE as error:
            self.damage = one_line(error) or type(error).__name__
            self._open(path)

    def _open(self, path: Path) -> None:
        """Read the topics, and all pages of the table of messages if the file seems whole."""
        self._database = _connect(path)
        try:
            if self.damage:
                # Otherwise SQLite rejects a file that is shorter than its header declares.
                self._database.execute('PRAGMA writable_schema = ON')
            (tables,), = self._database.execute(_TABLES)
            if tables != 2:
                raise ValueError('it has no tables of topics and messages')
            self.topics = _topics(self._database)
            if not self.damage:
                self._database.execute(_ALL_PAGES).fetchall()
        except UNREADABLE:
            self.close()
            raise

    def messages(self, numbers: Collection[int]) -> Iterator[StoredMessage]:
        """
        Yield the messages of the topics with these numbers.

        They come in the order of their log times, those of a damaged file in the order in which
        they were written.
        """
        for number, logged_ns, data in self._rows(numbers):
            if not (isinstance(logged_ns, int) and isinstance(data, bytes)):
                raise ValueError('a message has no time or no bytes')
            yield StoredMessage(number, logged_ns, data)

    def _rows(self, numbers: Collection[int]) -> Iterator[tuple[int, object, object]]:
        if not self.damage:
            places = ','.join('?' * len(numbers))
            yield from self._database.execute(_IN_TIME_ORDER.format(places), [*numbers])
            return
        last = 0
        for row, *values in self._database.execute(_AS_WRITTEN):
            # SQLite takes the missing rest of a page that is cut off to be zeros.
            if row <= last or values[-1] is None:
                raise ValueError(f'message {last + 1} is not whole')
            last = row
            if values[0] in numbers:
                yield tuple(values)

    def close(self) -> None:
        """Close the file."""
        self._database.close()


def _topics(database: sqlite3.Connection) -> list[Topic]:
    """Return the topics; the columns depend on the version of rosbag2."""
    rows = database.execute('SELECT * FROM topics')
    names = [column[0] for column in rows.description]
    return [
        Topic(item['id'], str(item['name']), str(item['type']),
              str(item.get('type_description_hash') or ''))
        for item in (dict(zip(names, row)) for row in rows)]


def _connect(path: Path) -> sqlite3.Connection:
    """Open a file for reading, as it is: without locks, and without what a journal holds."""
    database = sqlite3.connect(f'{path.resolve().as_uri()}?mode=ro&immutable=1', uri=True)
    database.execute('PRAGMA trusted_schema = OFF')
    return database


def _complete(path: Path) -> None:
    """
    Undo or complete what a killed writer left in a journal.

    Raises
    ------
    sqlite3.Error
        If the file cannot be written to.

    """
    if any(path.with_name(f'{path.name}{end}').exists() for end in ('-journal', '-wal')):
        with closing(sqlite3.connect(path)) as database:
            database.execute('PRAGMA wal_checkpoint(TRUNCATE)').fetchall()
            database.execute('SELECT count(*) FROM sqlite_master').fetchall()
