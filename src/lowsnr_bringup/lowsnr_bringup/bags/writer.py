"""
Writing rosbag2 bags that are whole up to the last second, whatever ends the writer.

The files are written by ``rosbags``; every second all that came is handed to the operating
system, with metadata that name every topic.  A bag whose writer was killed lacks the index at
its end and has old counts, which :mod:`lowsnr_bringup.bags.reader` makes do without.
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

from lowsnr_bringup.bags.definitions import type_definition
from lowsnr_bringup.bags.storage import Snapshot
from lowsnr_bringup.bags.storage import SteadyMcap
from lowsnr_bringup.bags.storage import SteadySqlite3
from rosbags.interfaces import Connection
from rosbags.interfaces import Qos
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer

_PLUGINS = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}
METADATA_FILE = 'metadata.yaml'


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
        Texts by name that the bag's metadata shall carry.

    Raises
    ------
    ValueError
        One line, if the folder exists or cannot be made.

    """

    def __init__(
        self, folder: Path, storage: str = 'mcap', custom: Mapping[str, str] | None = None,
    ) -> None:
        refuse_existing(folder)
        self.folder = folder
        self._bag = _Writer(folder, version=9, storage_plugin=_PLUGINS[storage])
        self._bag.custom_data.update(custom or {})
        try:
            self._bag.open()
            self._file = os.stat(self._bag.storage.path)
        except (OSError, sqlite3.Error) as error:
            raise ValueError(f'{folder}: the bag cannot be written: {error}') from None

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def add_topic(self, name: str, msgtype: str, qos: Sequence[Qos] = ()) -> Connection:
        """
        Add a topic with the definition and hash of its type; return what ``write`` wants.

        Raises
        ------
        ValueError
            If no installed package defines the type.

        """
        definition = type_definition(msgtype)
        return self._bag.add_connection(
            name, msgtype, msgdef=definition.text, rihs01=definition.digest,
            offered_qos_profiles=qos)

    def write(self, topic: Connection, data: bytes, logged_ns: int, published_ns: int) -> None:
        """
        Write a serialized message.

        Parameters
        ----------
        topic
            As ``add_topic`` returned it.
        data
            The message in CDR.
        logged_ns, published_ns
            When it came and when it was sent [ns]; SQLite keeps the first only.

        Raises
        ------
        OSError, sqlite3.Error
            If the disk is full or fails.

        """
        self._bag.storage.published_ns = published_ns
        self._bag.write(topic, logged_ns, data)

    def tell(self, key: str, text: str) -> None:
        """Have the metadata carry a text."""
        self._bag.set_custom_data(key, text)

    def sync(self) -> None:
        """
        Make the bag whole up to here, whatever comes.

        Raises
        ------
        OSError, sqlite3.Error
            If the disk is full or fails; FileNotFoundError if the bag was removed.

        """
        self._bag.sync()
        if not os.path.samestat(self._file, os.stat(self._bag.storage.path)):
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))

    def close(self) -> None:
        """Write index and metadata."""
        if self._bag.storage is not None:
            self._bag.close()

    def abort(self) -> None:
        """Close where nothing more can be written; what was synced stays."""
        with suppress(OSError, sqlite3.Error):
            self._bag.abort()


class _Writer(Writer):
    """A writer whose metadata can be written at any time, not at the end alone."""

    STORAGE_PLUGINS = {
        StoragePlugin.MCAP: SteadyMcap, StoragePlugin.SQLITE3: SteadySqlite3}

    described = 0
    storage: Any

    def sync(self) -> None:
        storage = self.storage
        storage.sync()
        if self.described == len(self.connections):
            return
        self.described = len(self.connections)
        self.storage = Snapshot(storage.path)
        try:
            super().close()
        finally:
            self.storage = storage


def refuse_existing(folder: Path) -> None:
    """
    Check that nothing stands where a bag shall be written, and make the folders above it.

    Raises
    ------
    ValueError
        One line, if something does, or they cannot be made.

    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        exists = folder.exists() or folder.is_symlink()
    except OSError as error:
        raise ValueError(f'{folder}: the bag cannot be written: {error.strerror}') from None
    if exists:
        raise ValueError(
            f'{folder}: exists, and nothing is overwritten; name another folder for the bag')
