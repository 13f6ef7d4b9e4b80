# SPDX-License-Identifier: Apache-2.0
"""Images in bags of ROS 1, as messages of ROS 2."""

from __future__ import annotations

import bz2
from collections.abc import Callable
from collections.abc import Collection
from collections.abc import Iterator
from collections.abc import Sequence
from pathlib import Path

from lowsnr_bringup.bags.compression import MAX_BYTES
from lowsnr_bringup.bags.storage import StoredMessage
from lowsnr_bringup.bags.storage import Topic
from lz4.frame import LZ4FrameDecompressor
from rosbags.rosbag1 import Reader
from rosbags.rosbag1 import ReaderError
from rosbags.rosbag1.reader import decompressors
from rosbags.typesys import get_typestore
from rosbags.typesys import Stores

MAGIC = b'#ROSBAG V2.0\n'
# Types that have the same fields in ROS 1 and ROS 2, with the digests of ROS 1.
_DIGESTS = {
    'sensor_msgs/msg/Image': '060021388200f6f0f447d0fcd9c64743',
    'sensor_msgs/msg/CompressedImage': '8f7a12909da2c9d3332d540a0977563f'}
# The library's own functions take as much memory as the data ask for.
_BOUNDED: dict[Callable[[bytes], bytes], Callable[[bytes], bytes]] = {
    decompressors['none']: decompressors['none'],
    decompressors['bz2']: lambda data: bz2.BZ2Decompressor().decompress(data, MAX_BYTES),
    decompressors['lz4']: lambda data: LZ4FrameDecompressor().decompress(data, MAX_BYTES)}


class Ros1StorageReader:
    """
    A bag of ROS 1, open for reading; topics of other types than images are left out.

    Raises
    ------
    ValueError
        If the file is damaged or has no index.

    """

    damage = ''

    def __init__(self, path: Path) -> None:
        self._reader = Reader(path)
        try:
            self._reader.open()
        except ReaderError as error:
            raise ValueError(f'{error} (rosbag reindex makes one)' if 'index' in str(error)
                             else str(error)) from None
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._connections = {
            item.id: item for item in self._reader.connections
            if _DIGESTS.get(item.msgtype) == item.digest}
        for place, chunk in self._reader.chunks.items():
            self._reader.chunks[place] = chunk._replace(
                decompressor=_BOUNDED[chunk.decompressor])

    @property
    def topics(self) -> Sequence[Topic]:
        """Topics with images."""
        return [Topic(number, item.topic, item.msgtype)
                for number, item in self._connections.items()]

    def messages(self, numbers: Collection[int]) -> Iterator[StoredMessage]:
        """Yield the messages of some topics in the order of their log times."""
        wanted = [self._connections[number] for number in numbers if number in self._connections]
        if not wanted:
            return
        try:
            for item, logged_ns, data in self._reader.messages(wanted):
                yield StoredMessage(
                    item.id, logged_ns, bytes(self._store.ros1_to_cdr(data, item.msgtype)))
        except ReaderError as error:
            raise ValueError(str(error)) from None

    def close(self) -> None:
        """Close the file."""
        self._reader.close()
