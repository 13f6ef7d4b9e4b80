"""
Reading rosbag2 bags, whoever wrote them and however they ended.

A file that is damaged is used up to the damage, and :attr:`Bag.notes` says so.
"""

from __future__ import annotations

from collections.abc import Collection
from collections.abc import Iterator
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any
from typing import NamedTuple

from lowsnr_bringup.bags.definitions import type_definition
from lowsnr_bringup.bags.files import BagFiles
from lowsnr_bringup.bags.files import find_files
from lowsnr_bringup.bags.files import unpack
from lowsnr_bringup.bags.packing import unpacked
from lowsnr_bringup.bags.salvage import BROKEN
from lowsnr_bringup.bags.salvage import MCAP_MAGIC
from lowsnr_bringup.bags.salvage import roll_back
from lowsnr_bringup.bags.salvage import SalvagedMcap
from lowsnr_bringup.bags.salvage import SalvagedSqlite3
from lowsnr_bringup.bags.salvage import SQLITE_MAGIC
from lowsnr_common.settings.text import one_line
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
from rosbags.typesys import get_types_from_msg
from rosbags.typesys import get_typestore
from rosbags.typesys import Stores
from rosbags.typesys.store import Typestore

_READERS = {
    MCAP_MAGIC: (McapReader, SalvagedMcap), SQLITE_MAGIC: (Sqlite3Reader, SalvagedSqlite3)}


class Message(NamedTuple):
    """A serialized message: its topic, when it was received [ns], and its bytes."""

    topic: str
    logged_ns: int
    data: bytes


class Bag:
    """
    A bag that is open for reading; use it in ``with``.

    ``topics`` are the types of the topics by name, ``custom`` the texts of its metadata,
    ``notes`` one line for each thing that was damaged or missing, which grow with the reading.

    Parameters
    ----------
    path
        Folder of the bag, or a storage file.

    Raises
    ------
    ValueError
        One line that names the file and what is wrong.

    """

    def __init__(self, path: Path) -> None:
        self.path = path
        files = find_files(path)
        self.custom = dict(files.custom)
        self.notes = list(files.notes)
        self.topics: dict[str, str] = {}
        self._digests: dict[str, str] = {}
        self._packed = files.compression == 'message'
        self._open = ExitStack()
        try:
            self._storages = [self._storage(item) for item in self._plain_files(files)]
        except ValueError:
            self.close()
            raise
        for connection in (item for _, reader in self._storages for item in reader.connections):
            if not (connection.topic.isprintable() and connection.msgtype.isprintable()):
                self.notes.append(f'{path}: leaves out the topic {connection.topic!r}')
                continue
            self.topics.setdefault(connection.topic, connection.msgtype)
            if connection.digest:
                self._digests.setdefault(connection.msgtype, connection.digest)

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
        """Yield the messages of some topics, in the order of the files."""
        for path, reader in self._storages:
            wanted = [item for item in reader.connections if item.topic in topics]
            count = 0
            try:
                for connection, logged_ns, data in _read(reader, wanted):
                    plain = unpacked(data) if self._packed else data
                    yield Message(connection.topic, logged_ns, plain)
                    count += 1
            except BROKEN as error:
                self._note(path, f'is damaged after {count} of the messages asked for', error)

    def read(self, message: Message) -> Any:
        """
        Return a message as an object with the fields of its type.

        Raises
        ------
        ValueError
            If the bag's definition of the type is not the installed one, or the bytes do not
            fit it.

        """
        msgtype = self.topics[message.topic]
        known = type_definition(msgtype).digest
        if self._digests.get(msgtype, known) != known:
            raise ValueError(
                f'{self.path}: {message.topic}: its definition of {msgtype} is not the installed '
                f'one ({self._digests[msgtype]}, not {known})')
        try:
            return _typestore(msgtype).deserialize_cdr(message.data, msgtype)
        except BROKEN as error:
            raise ValueError(f'{self.path}: {message.topic}: a message of {len(message.data)} '
                             f'bytes is no {msgtype}: {_say(error)}') from None

    def _plain_files(self, files: BagFiles) -> list[tuple[Path, Path]]:
        """Return every file as it is called and as it can be read."""
        if files.compression != 'file':
            return [(path, path) for path in files.paths]
        folder = Path(self._open.enter_context(TemporaryDirectory()))
        plain = []
        for path in files.paths:
            plain.append((path, folder / path.stem))
            if trouble := unpack(*plain[-1]):
                self.notes.append(f'{trouble}; used up to there')
        return plain

    def _storage(self, names: tuple[Path, Path]) -> tuple[Path, Any]:
        """Open a storage file; where it is damaged, what is whole of it."""
        path, plain = names
        whole, salvaged = _READERS[_magic(path, plain)]
        try:
            if whole is Sqlite3Reader:
                roll_back(plain)
            reader = whole(plain)
            reader.open()
        except BROKEN as error:
            reader = salvaged(plain)
            try:
                reader.open()
            except BROKEN:
                raise ValueError(f'{path}: cannot be read: {_say(error)}') from None
            self._note(path, 'is damaged or was not closed', error)
        self._open.callback(reader.close)
        return path, reader

    def _note(self, path: Path, what: str, error: BaseException) -> None:
        self.notes.append(f'{path}: {what} ({_say(error)}); used up to there')


def _magic(path: Path, plain: Path) -> bytes:
    try:
        with plain.open('rb') as file:
            head = file.read(max(map(len, _READERS)))
    except OSError as error:
        raise ValueError(f'{path}: cannot be read: {error.strerror}') from None
    if not head:
        raise ValueError(f'{path}: is empty (zero bytes)')
    for magic in _READERS:
        if head.startswith(magic):
            return magic
    raise ValueError(f'{path}: is not a bag: it is neither MCAP nor SQLite')


def _read(reader: Any, connections: list[Any]) -> Iterator[tuple[Any, int, bytes]]:
    if not connections:
        return iter(())
    if isinstance(reader, McapReader) and not reader.chunks:
        return reader.messages_scan(connections)  # what has no index need not be in order
    return reader.messages(connections)


@cache
def _typestore(msgtype: str) -> Typestore:
    """Return a store of the installed definition; what a bag defines is never made code."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(type_definition(msgtype).text, msgtype))
    return store


def _say(error: BaseException) -> str:
    return one_line(error).rstrip('.') or type(error).__name__
