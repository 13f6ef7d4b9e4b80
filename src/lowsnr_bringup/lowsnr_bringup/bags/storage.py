# SPDX-License-Identifier: Apache-2.0
"""What the two storage formats of bags have in common: topics, and the interfaces to them."""

from __future__ import annotations

from collections.abc import Collection
from collections.abc import Iterator
from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from typing import NamedTuple
from typing import Protocol

METADATA_VERSION, ROS_DISTRO = 9, 'jazzy'
# The offered quality of service of a publisher, as rosbag2 writes it.
Qos = Mapping[str, Any]


@dataclass(frozen=True)
class Topic:
    """
    A topic of a bag.

    Attributes
    ----------
    number
        Its number within the storage file.
    name, msgtype
        Its name, and a type such as ``sensor_msgs/msg/Image``.
    digest
        Hash of the type as DDS advertises it; ``''`` if the bag does not hold it.

    """

    number: int
    name: str
    msgtype: str
    digest: str = ''


class StoredMessage(NamedTuple):
    """A message in a storage file: number of its topic, time of receipt [ns], and its bytes."""

    number: int
    logged_ns: int
    data: bytes


class StorageReader(Protocol):
    """
    A storage file, open for reading.

    ``damage`` is why the file is not whole, ``''`` for a whole file; a damaged file is read up to
    its damage.
    """

    damage: str

    @property
    def topics(self) -> Sequence[Topic]:
        """Topics of the file."""

    def messages(self, numbers: Collection[int]) -> Iterator[StoredMessage]:
        """
        Yield the messages of the topics with these numbers.

        They come in the order of their log times, those of a damaged file in the order in which
        they were written.
        """

    def close(self) -> None:
        """Close the file."""


class StorageWriter(Protocol):
    """A storage file, open for writing; every method raises OSError on a full disk."""

    def __init__(self, path: Path) -> None:
        """Create the file."""

    def add_topic(self, topic: Topic, definition: str, qos: str) -> None:
        """Add a topic with the definition of its type and its quality of service as YAML."""

    def write(self, number: int, data: bytes, logged_ns: int, published_ns: int) -> None:
        """Write a message of the topic with this number."""

    def flush(self) -> None:
        """Hand all messages to the operating system: they outlast the process."""

    def close(self, metadata: str) -> None:
        """Write the index and the metadata of the bag, and close the file."""

    def abort(self) -> None:
        """Close the file as it is."""
