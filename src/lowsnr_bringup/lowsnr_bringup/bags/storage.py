"""The storages of ``rosbags``, made to keep what is written up to the last second."""

from __future__ import annotations

from collections import defaultdict
from io import BytesIO
from pathlib import Path
import struct

from rosbags.interfaces import Connection
from rosbags.rosbag2.enums import CompressionMode
from rosbags.rosbag2.storage_mcap import Channel
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.rosbag2.storage_mcap import PendingChunk
from rosbags.rosbag2.storage_mcap import write_channel
from rosbags.rosbag2.storage_mcap import write_string
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

_CHUNK_BYTES = 2**20
# Heads of records, as the MCAP specification has them: kind and length first.
_CHUNK = struct.Struct('<BQQQQIIQ')
_MESSAGE = struct.Struct('<BQHIQQ')
_MESSAGE_INDEX = struct.Struct('<BQHI')
_CHUNK_INDEX = struct.Struct('<QQQQI')
_CHUNK_INDEX_END = struct.Struct('<QIQQ')
_TIME_AND_PLACE, _TOPIC_AND_PLACE = struct.Struct('<QQ'), struct.Struct('<HQ')


class SteadyMcap(McapWriter):
    """
    MCAP with publish times and type hashes, flushed on request.

    A large message goes from its buffer to the file without being copied.
    """

    published_ns = 0
    chunk: PendingChunk

    def add_connection(self, connection: Connection, offered_qos_profiles: str) -> None:
        """Write the channel of a topic with the hash of its type, as rosbag2 does."""
        metadata = BytesIO()
        for text in ('offered_qos_profiles', offered_qos_profiles,
                     'topic_type_hash', connection.digest):
            write_string(metadata, text)
        self.channels.append(Channel(
            connection.id, connection.msgtype, connection.topic, 'cdr', metadata.getvalue()))
        self.channel_stats[connection.id] = 0
        write_channel(self.chunk.bio, self.channels[-1], self.schemas)

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Write a message with ``published_ns`` as its publish time."""
        chunk = self.chunk
        for item in (self, chunk):
            item.message_start_time = min(timestamp, item.message_start_time)
            item.message_end_time = max(timestamp, item.message_end_time)
        self.channel_stats[connection.id] += 1
        chunk.msgs[connection.id].append((timestamp, chunk.bio.tell()))
        chunk.bio.write(_MESSAGE.pack(
            0x05, 22 + len(data), connection.id, 0, timestamp, self.published_ns))
        if chunk.bio.tell() + len(data) > _CHUNK_BYTES:
            self.close_chunk(data)
        else:
            chunk.bio.write(data)

    def close_chunk(self, last: bytes | memoryview = b'') -> None:
        """Write the chunk, ended by the data of its last message where they are not in it yet."""
        chunk, start = self.chunk, self.bio.tell()
        times = chunk.message_start_time, chunk.message_end_time
        size = chunk.bio.tell() + len(last)
        self.bio.write(_CHUNK.pack(0x06, 40 + size, *times, size, 0, 0, size))
        self.bio.write(chunk.bio.getbuffer())
        self.bio.write(last)
        end = self.bio.tell()
        places = b''
        for topic, messages in chunk.msgs.items():
            places += _TOPIC_AND_PLACE.pack(topic, self.bio.tell())
            length = _TIME_AND_PLACE.size * len(messages)
            self.bio.write(_MESSAGE_INDEX.pack(0x07, 6 + length, topic, length))
            self.bio.write(b''.join(_TIME_AND_PLACE.pack(*item) for item in messages))
        index = BytesIO()
        index.write(_CHUNK_INDEX.pack(*times, start, end - start, len(places)))
        index.write(places)
        index.write(_CHUNK_INDEX_END.pack(self.bio.tell() - end, 0, size, size))
        self.chunks.append(index)
        self.chunk = PendingChunk(2**63 - 1, 0, BytesIO(), defaultdict(list))

    def sync(self) -> None:
        """Hand what was written to the operating system."""
        if self.chunk.msgs:
            self.close_chunk()
        self.bio.flush()


class SteadySqlite3(Sqlite3Writer):
    """SQLite, committed on request; it has no place for publish times."""

    published_ns = 0

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        # Large pages take large frames faster; an empty file can still change to them.
        self.conn.execute('PRAGMA page_size = 65536')
        self.conn.execute('VACUUM')
        # Outlasts the end of the process; waiting for the disk would cost frames.
        self.conn.execute('PRAGMA synchronous = OFF')

    def sync(self) -> None:
        """Hand what was written to the operating system."""
        self.conn.commit()


class Snapshot:
    """Takes the place of a storage while the bag's metadata are written."""

    published_ns = 0

    def __init__(self, path: Path) -> None:
        self.path = path

    def close(self, version: int, metadata: str) -> None:
        """Leave the storage open."""
