# SPDX-License-Identifier: Apache-2.0
"""
MCAP storage files, by the ``mcap`` package.

The reader takes any bytes: it allocates no more memory than the file has bytes, unpacks chunks
within bounds, and reads a file without index, cut off or damaged, up to the damage.
"""

from __future__ import annotations

from collections.abc import Collection
from collections.abc import Iterable
from collections.abc import Iterator
from heapq import heappop
from heapq import heappush
from io import BufferedReader
from io import BytesIO
from io import FileIO
from itertools import count
from itertools import zip_longest
from pathlib import Path
import zlib

from lowsnr_bringup.bags.compression import MAX_BYTES
from lowsnr_bringup.bags.compression import unpack
from lowsnr_bringup.bags.errors import UNREADABLE
from lowsnr_bringup.bags.storage import StoredMessage
from lowsnr_bringup.bags.storage import Topic
from lowsnr_common.settings.text import one_line
from mcap.reader import SeekingReader
from mcap.records import Channel
from mcap.records import Chunk
from mcap.records import ChunkIndex
from mcap.records import McapRecord
from mcap.records import Message
from mcap.records import Schema
from mcap.stream_reader import StreamReader
from mcap.well_known import MessageEncoding
from mcap.well_known import SchemaEncoding
from mcap.writer import CompressionType
from mcap.writer import Writer

MAGIC = b'\x89MCAP0\r\n'
_PROFILE = 'ros2'
_TYPE_HASH = 'topic_type_hash'


class McapStorageWriter:
    """
    Writer of an MCAP file; see :class:`~lowsnr_bringup.bags.storage.StorageWriter`.

    Messages are held in memory until a chunk of 1 MiB is full or ``flush`` is called.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open('xb')
        self._writer = Writer(self._file, compression=CompressionType.NONE)
        self._writer.start(_PROFILE, 'lowsnr')
        self._schemas: dict[str, int] = {}
        self._channels: dict[int, int] = {}

    def add_topic(self, topic: Topic, definition: str, qos: str) -> None:
        """Add a topic with the definition of its type and its quality of service as YAML."""
        if topic.msgtype not in self._schemas:
            self._schemas[topic.msgtype] = self._writer.register_schema(
                topic.msgtype, SchemaEncoding.ROS2, definition.encode())
        self._channels[topic.number] = self._writer.register_channel(
            topic.name, MessageEncoding.CDR, self._schemas[topic.msgtype],
            {'offered_qos_profiles': qos, _TYPE_HASH: topic.digest})

    def write(self, number: int, data: bytes, logged_ns: int, published_ns: int) -> None:
        """Write a message of the topic with this number."""
        self._writer.add_message(self._channels[number], logged_ns, data, published_ns)

    def flush(self) -> None:
        """Hand all messages to the operating system: they outlast the process."""
        self._writer.flush()

    def close(self, metadata: str) -> None:
        """Write the index and the metadata of the bag, and close the file."""
        self._writer.add_metadata('rosbag2', {'serialized_metadata': metadata})
        self._writer.finish()
        self._file.close()

    def abort(self) -> None:
        """Close the file as it is."""
        self._file.close()


class McapStorageReader:
    """
    Reader of an MCAP file; see :class:`~lowsnr_bringup.bags.storage.StorageReader`.

    Raises
    ------
    UNREADABLE
        If the file does not even start as an MCAP file.

    """

    def __init__(self, path: Path) -> None:
        self._file = _BoundedFile(FileIO(path))
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._chunks: list[ChunkIndex] = []
        self._end = 0  # of the last whole record
        self.damage = ''
        try:
            self._read_summary()
        except UNREADABLE as error:
            self.damage = one_line(error) or type(error).__name__
        try:
            if self.damage or not self._chunks:
                self._scan()
        except UNREADABLE:
            self.close()
            raise

    @property
    def topics(self) -> list[Topic]:
        """Topics of the file."""
        return [
            Topic(channel.id, channel.topic, self._schemas[channel.schema_id].name,
                  channel.metadata.get(_TYPE_HASH, ''))
            for channel in self._channels.values() if channel.schema_id in self._schemas]

    def messages(self, numbers: Collection[int]) -> Iterator[StoredMessage]:
        """
        Yield the messages of the topics with these numbers.

        They come in the order of their log times; those of a file without index in the order in
        which they were written.
        """
        if self._chunks:
            yield from self._in_time_order(set(numbers))
        else:
            yield from _stored(self._records(), numbers)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _read_summary(self) -> None:
        """Take topics and index of chunks from the end of the file, if they are there."""
        summary = SeekingReader(self._file, record_size_limit=MAX_BYTES).get_summary()
        if summary is not None and summary.schemas and summary.channels:
            self._schemas, self._channels = summary.schemas, summary.channels
            self._chunks = sorted(
                summary.chunk_indexes,
                key=lambda chunk: (chunk.message_start_time, chunk.chunk_start_offset))

    def _scan(self) -> None:
        """Find the topics by reading the file from its start to its end or the damage."""
        self._schemas, self._channels, self._chunks = {}, {}, []
        self._file.seek(0)
        records = StreamReader(self._file, emit_chunks=True, record_size_limit=MAX_BYTES).records
        try:
            for record in records:
                for item in _unpacked(record):
                    if isinstance(item, Schema):
                        self._schemas[item.id] = item
                    elif isinstance(item, Channel):
                        self._channels.setdefault(item.id, item)
                self._end = self._file.tell()
        except UNREADABLE as error:
            if not self._end:
                raise
            self.damage = self.damage or one_line(error) or type(error).__name__

    def _records(self) -> Iterator[McapRecord]:
        """Yield the records up to the last whole one, in the order of the file."""
        self._file.seek(0)
        records = StreamReader(self._file, emit_chunks=True, record_size_limit=MAX_BYTES).records
        while self._file.tell() < self._end:
            yield from _unpacked(next(records))

    def _in_time_order(self, numbers: set[int]) -> Iterator[StoredMessage]:
        """Yield the messages of these topics chunk by chunk, sorted across chunks that overlap."""
        chunks = [chunk for chunk in self._chunks if not chunk.message_index_offsets
                  or numbers & chunk.message_index_offsets.keys()]
        waiting: list[tuple[int, int, StoredMessage]] = []
        order = count()
        for chunk, following in zip_longest(chunks, chunks[1:]):
            for message in _stored(self._chunk_at(chunk.chunk_start_offset), numbers):
                heappush(waiting, (message.logged_ns, next(order), message))
            while waiting and (
                    following is None or waiting[0][0] < following.message_start_time):
                yield heappop(waiting)[2]

    def _chunk_at(self, start: int) -> list[McapRecord]:
        """Return the records of the chunk at a place of the file."""
        self._file.seek(start)
        records = StreamReader(
            self._file, skip_magic=True, emit_chunks=True, record_size_limit=MAX_BYTES).records
        return _unpacked(next(records))


class _BoundedFile(BufferedReader):
    """A file; reading more bytes than it has takes no memory for the bytes that it lacks."""

    def __init__(self, raw: FileIO) -> None:
        super().__init__(raw)
        self._size = self.seek(0, 2)
        self.seek(0)

    def read(self, size: int | None = -1, /) -> bytes:
        left = max(0, self._size - self.tell())
        return super().read(left if size is None or size < 0 else min(size, left))


def _unpacked(record: McapRecord) -> list[McapRecord]:
    """Return the records of a chunk, or any other record by itself."""
    if not isinstance(record, Chunk):
        return [record]
    plain = unpack(record.data, record.uncompressed_size, record.compression)
    if record.uncompressed_crc not in (0, zlib.crc32(plain)):
        raise ValueError('the check sum of a chunk is wrong')
    stream, found = BytesIO(plain), []
    records = StreamReader(stream, skip_magic=True, emit_chunks=True).records
    while stream.tell() < len(plain):
        found.append(next(records, record))
        if isinstance(found[-1], Chunk):
            raise ValueError('a chunk holds a chunk or an end of the file')
    return found


def _stored(records: Iterable[McapRecord], numbers: Collection[int]) -> Iterator[StoredMessage]:
    """Yield the messages of the topics with these numbers."""
    for record in records:
        if isinstance(record, Message) and record.channel_id in numbers:
            yield StoredMessage(record.channel_id, record.log_time, record.data)
