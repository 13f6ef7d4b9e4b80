"""The files of a bag: found, checked, and unpacked where they are compressed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field
from pathlib import Path
from pathlib import PurePosixPath
import re
from typing import Any

from lowsnr_bringup.bags.writer import METADATA_FILE
from lowsnr_common.settings.text import one_line
from lowsnr_common.settings.text import read_yaml
from rosbags.rosbag2.reader import zstd

_INFORMATION = 'rosbag2_bagfile_information'
_SUFFIXES = ('.mcap', '.db3', '.mcap.zstd', '.db3.zstd')
_COMPRESSIONS = ('', 'none', 'file', 'message')
_BLOCK = 2**20


@dataclass(frozen=True)
class BagFiles:
    """
    What a bag consists of.

    ``paths`` are its storage files in order, ``compression`` says what is compressed: nothing
    (``''``), each ``'file'`` or each ``'message'``; ``custom`` are the texts of its metadata.
    ``notes`` say what had to be done without.
    """

    paths: list[Path]
    compression: str = ''
    custom: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def find_files(path: Path) -> BagFiles:
    """
    Return the files of a bag, which is a folder or a storage file alone.

    Raises
    ------
    ValueError
        One line that names the file and what is wrong.

    """
    if not path.exists():
        raise ValueError(f'{path}: there is no such bag')
    if not path.is_dir():
        return BagFiles([path], _compression_of(path))
    metadata = path / METADATA_FILE
    if not metadata.exists():
        found = sorted((item for item in path.iterdir() if item.name.endswith(_SUFFIXES)),
                       key=_number)
        if not found:
            raise ValueError(f'{path}: is not a bag: it has neither {METADATA_FILE} nor storage')
        found = [_inside(path, item.name, path) for item in found]
        note = f'{metadata}: is missing; the files beside where it should be are taken'
        return BagFiles(found, _compression_of(found[0]), {}, (note,))
    try:
        return _from_metadata(path, metadata)
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(
            f'{metadata}: is not the metadata of a bag: '
            f'{type(error).__name__} {one_line(error)}') from None


def _from_metadata(folder: Path, metadata: Path) -> BagFiles:
    information = read_yaml(metadata)[_INFORMATION]
    paths = [_inside(folder, str(name), metadata) for name in information['relative_file_paths']]
    compression = str(information.get('compression_mode') or '').lower()
    if compression not in _COMPRESSIONS:
        raise ValueError(f'{metadata}: compression mode {compression!r} is not known')
    form = information.get('compression_format') or 'zstd'
    if compression not in ('', 'none') and form != 'zstd':
        raise ValueError(f'{metadata}: compression format {form!r} is not known')
    custom = {str(key): str(text) for key, text in (information.get('custom_data') or {}).items()}
    return BagFiles(paths, compression.replace('none', ''), custom)


def _inside(folder: Path, name: str, source: Path) -> Path:
    """Return a file of the bag; a path may name the bag's folder, as old versions did."""
    parts = PurePosixPath(name).parts
    path = folder / (parts[-1] if parts else '')
    leaves = not parts or parts[0] == '/' or '..' in parts or '\0' in name
    if leaves or not path.resolve().is_relative_to(folder.resolve()):
        raise ValueError(f"{source}: {name!r} leads out of the bag's folder")
    if not path.is_file():
        raise ValueError(f'{path}: is missing, though {METADATA_FILE} names it')
    return path


def _compression_of(path: Path) -> str:
    return 'file' if path.name.endswith('.zstd') else ''


def _number(path: Path) -> list[Any]:
    """Return a key that sorts ``bag_2`` before ``bag_10``."""
    return [(int(part), '') if part.isdigit() else (0, part)
            for part in re.split(r'(\d+)', path.name)]


def unpack(source: Path, target: Path) -> str:
    """Unpack a compressed file as far as it is whole; return what is wrong, or nothing."""
    try:
        with zstd.open(source, 'rb') as packed, target.open('wb') as plain:
            while block := packed.read(_BLOCK):
                plain.write(block)
    except (zstd.ZstdError, EOFError, OSError) as error:  # it may also be too large for the disk
        return f'{source}: {one_line(error)}'
    return ''
