# SPDX-License-Identifier: Apache-2.0
"""
Reading rosbag2 bags of any writer, whole or damaged.

The reader uses a damaged file up to the damage, and adds a line to :attr:`Bag.notes`.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Collection
from collections.abc import Iterator
from collections.abc import Mapping
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any
from typing import NamedTuple

from lowsnr_bringup.bags import mcap_storage
from lowsnr_bringup.bags import ros1_storage
from lowsnr_bringup.bags import sqlite_storage
from lowsnr_bringup.bags.bag_files import BagFiles
from lowsnr_bringup.bags.bag_files import find_files
from lowsnr_bringup.bags.compression import unpack_file
from lowsnr_bringup.bags.compression import unpack_message
from lowsnr_bringup.bags.errors import UNREADABLE
from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.bags.storage import StorageReader
from lowsnr_bringup.bags.type_definitions import type_definition
from lowsnr_common.settings.text import one_line
from rosbags.typesys import get_types_from_msg
from rosbags.typesys import get_typestore
from rosbags.typesys import Stores
from rosbags.typesys.store import Typestore

_READERS: Mapping[bytes, Callable[[Path], StorageReader]] = {
    mcap_storage.MAGIC: mcap_storage.McapStorageReader,
    ros1_storage.MAGIC: ros1_storage.Ros1StorageReader,
    sqlite_storage.MAGIC: sqlite_storage.SqliteStorageReader}


class Message(NamedTuple):
    """A serialized message: its topic, when it was received [ns], and its bytes."""

    topic: str
    logged_ns: int
    data: bytes


class Bag:
    """
    A bag that is open for reading; use it in ``with``.

    Parameters
    ----------
    path
        Folder of the bag, or a storage file.

    Attributes
    ----------
    topics
        Types of the topics by name.
    custom
        Texts that the metadata carry, by name.
    notes : list of str
        A line for each thing that is damaged or missing; reading messages may add some.

    Raises
    ------
    UnusableFile
        With a reason of :func:`~lowsnr_bringup.bags.bag_files.find_files`, or ``unreadable``,
        ``empty``, ``not a bag`` or ``no room`` (to unpack it).

    """

    def __init__(self, path: Path) -> None:
        self.path = path
        files = find_files(path)
        self.custom = dict(files.custom)
        self.notes = list(files.notes)
        self.topics: dict[str, str] = {}
        self._digests: dict[str, str] = {}
        self._messages_packed = files.compression == 'message'
        self._open = ExitStack()
        try:
            self._storages = [
                (original, self._storage(original, plain))
                for original, plain in self._plain_files(files)]
        except ValueError:
            self.close()
            raise
        for topic in (item for _, storage in self._storages for item in storage.topics):
            if not (topic.name.isprintable() and topic.msgtype.isprintable()):
                self.notes.append(f'{path}: the topic {topic.name!r} is left out')
                continue
            self.topics.setdefault(topic.name, topic.msgtype)
            if topic.digest:
                self._digests.setdefault(topic.msgtype, topic.digest)

    def __enter__(self) -> Bag:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the files."""
        self._open.close()

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """
        Yield the messages of some topics, one file after the other.

        Those of a whole file come in the order of their log times, those of a damaged one in the
        order in which they were written.
        """
        for path, storage in self._storages:
            names = {item.number: item.name for item in storage.topics if item.name in topics}
            count = 0
            try:
                for number, logged_ns, data in storage.messages(names) if names else ():
                    plain = unpack_message(data) if self._messages_packed else data
                    yield Message(names[number], logged_ns, plain)
                    count += 1
            except UNREADABLE as error:
                self._note_damage(
                    path, f'is damaged after {count} of the messages asked for', _text(error))

    def read(self, message: Message) -> Any:
        """
        Return a message as an object with the fields of its type.

        Raises
        ------
        UnusableFile
            If the bag's definition of the type is not the installed one (reason ``other type``),
            or the bytes do not fit it (``bad message``).
        ValueError
            If no installed package defines the type.

        """
        msgtype = self.topics[message.topic]
        known = type_definition(msgtype).digest
        if self._digests.get(msgtype, known) != known:
            raise UnusableFile(
                self.path, 'other type',
                f'{message.topic}: its definition of {msgtype} is not the installed one '
                f'({self._digests[msgtype]}, not {known})')
        try:
            return _typestore(msgtype).deserialize_cdr(message.data, msgtype)
        except UNREADABLE as error:
            raise UnusableFile(
                self.path, 'bad message', f'{message.topic}: a message of {len(message.data)} '
                f'bytes is no {msgtype}: {_text(error)}') from None

    def _plain_files(self, files: BagFiles) -> Iterator[tuple[Path, Path]]:
        """Yield every file with the one that can be read in its place."""
        if files.compression != 'file':
            yield from zip(files.paths, files.paths)
            return
        try:
            folder = Path(self._open.enter_context(TemporaryDirectory()))
        except OSError as error:
            raise UnusableFile(
                self.path, 'no room', f'cannot be unpacked: {error.strerror}; set TMPDIR to a '
                'folder with room') from None
        for path in files.paths:
            plain = folder / path.stem
            if fault := unpack_file(path, plain):
                self._note_damage(path, 'is damaged', fault)
            yield path, plain

    def _storage(self, path: Path, plain: Path) -> StorageReader:
        """Open a storage file."""
        kind = _READERS[_magic(path, plain)]
        try:
            storage = kind(plain)
        except UNREADABLE as error:
            raise UnusableFile(path, 'unreadable', f'cannot be read: {_text(error)}') from None
        self._open.callback(storage.close)
        if storage.damage:
            self._note_damage(path, 'is damaged or was not closed', storage.damage)
        return storage

    def _note_damage(self, path: Path, what: str, fault: str) -> None:
        self.notes.append(f'{path}: {what} ({fault.rstrip(".")}); used up to there')


def _magic(path: Path, plain: Path) -> bytes:
    """Return the first bytes of a file, which are those of its format."""
    try:
        with plain.open('rb') as file:
            head = file.read(max(map(len, _READERS)))
    except OSError as error:
        raise UnusableFile(path, 'unreadable', f'cannot be read: {error.strerror}') from None
    if not head:
        raise UnusableFile(path, 'empty', 'is empty (zero bytes)')
    for magic in _READERS:
        if head.startswith(magic):
            return magic
    raise UnusableFile(
        path, 'not a bag', 'is not a bag: it is neither MCAP nor SQLite nor a bag of ROS 1')


@cache
def _typestore(msgtype: str) -> Typestore:
    """Return a store of the installed definition; definitions of a bag are never made code."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(type_definition(msgtype).text, msgtype))
    return store


def _text(error: BaseException) -> str:
    return one_line(error).rstrip('.') or type(error).__name__
