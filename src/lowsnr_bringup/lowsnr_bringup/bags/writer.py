# SPDX-License-Identifier: Apache-2.0
"""
Writing rosbag2 bags that are readable up to the last ``sync``, however the writer ends.

A bag whose writer was killed lacks the index at its end, and its metadata hold old counts;
:mod:`lowsnr_bringup.bags.reader` reads it all the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from contextlib import suppress
import errno
import os
from pathlib import Path
import sqlite3
from types import TracebackType
from typing import Any

from lowsnr_bringup.bags.bag_files import INFORMATION
from lowsnr_bringup.bags.bag_files import METADATA_FILE
from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.bags.mcap_storage import McapStorageWriter
from lowsnr_bringup.bags.sqlite_storage import SqliteStorageWriter
from lowsnr_bringup.bags.storage import METADATA_VERSION
from lowsnr_bringup.bags.storage import Qos
from lowsnr_bringup.bags.storage import ROS_DISTRO
from lowsnr_bringup.bags.storage import StorageWriter
from lowsnr_bringup.bags.storage import Topic
from lowsnr_bringup.bags.type_definitions import type_definition
import yaml

_STORAGES: Mapping[str, tuple[str, type[StorageWriter]]] = {
    'mcap': ('.mcap', McapStorageWriter), 'sqlite3': ('.db3', SqliteStorageWriter)}


class BagWriter:
    """
    Writer of a bag; use it in ``with``, which closes the bag.

    Parameters
    ----------
    folder
        Folder of the bag; must not exist.
    storage
        ``'mcap'`` or ``'sqlite3'``.
    custom
        Texts by name that the metadata of the bag carry.

    Raises
    ------
    UnusableFile
        If the folder exists (reason ``exists``) or cannot be made (``not writable``).

    """

    def __init__(
        self, folder: Path, storage: str = 'mcap', custom: Mapping[str, str] | None = None,
    ) -> None:
        check_new(folder)
        self.folder = folder
        self.custom = dict(custom or {})
        self._format = storage
        self._topics: dict[Topic, Sequence[Qos]] = {}
        self._described = 0  # number of topics in the metadata on the disk
        self._counts: dict[int, int] = {}
        self._first_ns, self._last_ns = 2**63 - 1, 0
        suffix, kind = _STORAGES[storage]
        self._path = folder / f'{folder.name}{suffix}'
        try:
            folder.mkdir()
            self._storage: StorageWriter | None = kind(self._path)
            self._file = os.stat(self._path)
        except (OSError, sqlite3.Error) as error:
            raise UnusableFile(
                folder, 'not writable', f'the bag cannot be written: {error}') from None

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def add_topic(self, name: str, msgtype: str, qos: Sequence[Qos] = ()) -> Topic:
        """
        Add a topic; return it for :meth:`write`.

        Parameters
        ----------
        name, msgtype
            Its name, and a type such as ``sensor_msgs/msg/Image``.
        qos
            What its publishers offer.

        Raises
        ------
        ValueError
            If no installed package defines the type.

        """
        definition = type_definition(msgtype)
        topic = Topic(len(self._topics) + 1, name, msgtype, definition.digest)
        self._open_storage.add_topic(
            topic, definition.text, yaml.safe_dump([*qos], sort_keys=False).strip())
        self._topics[topic] = qos
        self._counts[topic.number] = 0
        return topic

    def write(self, topic: Topic, data: bytes, logged_ns: int, published_ns: int) -> None:
        """
        Write a serialized message.

        Parameters
        ----------
        topic
            As ``add_topic`` returned it.
        data
            The message in CDR.
        logged_ns, published_ns
            When it was received and when it was sent [ns]; SQLite keeps the first only.

        Raises
        ------
        OSError, sqlite3.Error
            If the disk is full or fails.

        """
        self._open_storage.write(topic.number, data, logged_ns, published_ns)
        self._counts[topic.number] += 1
        self._first_ns = min(logged_ns, self._first_ns)
        self._last_ns = max(logged_ns, self._last_ns)

    def sync(self) -> None:
        """
        Make the bag readable up to here, even if the process is killed.

        Raises
        ------
        OSError, sqlite3.Error
            If the disk is full or fails; FileNotFoundError if the bag was removed.

        """
        self._open_storage.flush()
        if not os.path.samestat(self._file, os.stat(self._path)):
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))
        if self._described < len(self._topics):
            self._write_metadata()
            self._described = len(self._topics)

    def close(self) -> None:
        """Write index and metadata; raises as :meth:`sync`."""
        if self._storage is not None:
            self._storage.close(yaml.safe_dump(self._metadata(), sort_keys=False))
            self._storage = None
            self._write_metadata()

    def abort(self) -> None:
        """Close the bag after an error; everything up to the last ``sync`` stays."""
        storage, self._storage = self._storage, None
        if storage is not None:
            with suppress(OSError, sqlite3.Error):
                storage.abort()

    @property
    def _open_storage(self) -> StorageWriter:
        if self._storage is None:
            raise ValueError(f'{self.folder}: the bag is closed')
        return self._storage

    def _write_metadata(self) -> None:
        """Write the metadata to a draft, and put it in the place of the file."""
        draft = self.folder / f'{METADATA_FILE}.draft'
        draft.write_text(
            yaml.safe_dump({INFORMATION: self._metadata()}, sort_keys=False), encoding='utf-8')
        draft.replace(self.folder / METADATA_FILE)

    def _metadata(self) -> dict[str, Any]:
        """Return the metadata of the bag in version 9 of rosbag2, that of Jazzy."""
        topics = [{
            'topic_metadata': {
                'name': topic.name, 'type': topic.msgtype, 'serialization_format': 'cdr',
                'offered_qos_profiles': [dict(item) for item in qos],
                'type_description_hash': topic.digest},
            'message_count': self._counts[topic.number]} for topic, qos in self._topics.items()]
        return {
            'version': METADATA_VERSION, 'storage_identifier': self._format, **self._extent(),
            'topics_with_message_count': topics,
            'compression_format': '', 'compression_mode': '',
            'relative_file_paths': [self._path.name],
            'files': [{'path': self._path.name, **self._extent()}],
            'custom_data': self.custom or None, 'ros_distro': ROS_DISTRO}

    def _extent(self) -> dict[str, Any]:
        """Return how much there is, and from when to when."""
        return {
            'starting_time': {'nanoseconds_since_epoch': self._first_ns},
            'duration': {'nanoseconds': max(0, self._last_ns - self._first_ns)},
            'message_count': sum(self._counts.values())}


def check_new(folder: Path) -> None:
    """
    Check that a bag can be written here, and make the folders above it.

    Raises
    ------
    UnusableFile
        If something is there (reason ``exists``), or the folders cannot be made
        (``not writable``).

    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        exists = os.path.lexists(folder)
        if not exists:  # nothing else tells for certain
            folder.mkdir()
            folder.rmdir()
    except OSError as error:
        raise UnusableFile(
            folder, 'not writable', f'the bag cannot be written: {error.strerror}') from None
    if exists:
        raise UnusableFile(
            folder, 'exists',
            'exists, and nothing is overwritten; name another folder for the bag')
