# SPDX-License-Identifier: Apache-2.0
"""The files of a bag: found, and kept within its folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field
import os
from pathlib import Path
from pathlib import PurePosixPath
import re

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_common.settings.text import one_line
from lowsnr_common.settings.text import read_yaml

METADATA_FILE = 'metadata.yaml'
INFORMATION = 'rosbag2_bagfile_information'
_SUFFIXES = ('.mcap', '.db3', '.mcap.zstd', '.db3.zstd', '.bag')
_COMPRESSIONS = ('', 'none', 'file', 'message')


@dataclass(frozen=True)
class BagFiles:
    """
    The files of a bag.

    Attributes
    ----------
    paths
        Its storage files in order.
    compression
        What is compressed: nothing (``''``), each ``'file'`` or each ``'message'``.
    custom
        The texts that its metadata carry, by name.
    notes : list of str
        A line for each thing that is missing.

    """

    paths: list[Path]
    compression: str = ''
    custom: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def is_bag(path: Path) -> bool:
    """Whether something is a bag by its name, or by the names of what it holds."""
    try:
        names = [item.name for item in path.iterdir()] if path.is_dir() else [path.name]
    except OSError:
        return False
    return any(name == METADATA_FILE or name.endswith(_SUFFIXES) for name in names)


def find_files(path: Path) -> BagFiles:
    """
    Return the files of a bag, which is a folder or a single storage file.

    Raises
    ------
    UnusableFile
        With reason ``missing``, ``not a bag``, ``bad metadata`` or ``outside the folder``.

    """
    if not os.path.exists(path):  # unlike Path.exists it takes a name of any length
        raise UnusableFile(path, 'missing', 'there is no such bag')
    if not path.is_dir():
        return BagFiles([path], _compression_of(path))
    metadata = path / METADATA_FILE
    if not metadata.exists():
        found = sorted((item for item in path.iterdir() if item.name.endswith(_SUFFIXES)),
                       key=by_number)
        if not found:
            raise UnusableFile(
                path, 'not a bag', f'is not a bag: it has neither {METADATA_FILE} nor storage')
        found = [_inside(path, item.name, path) for item in found]
        note = f'{metadata}: is missing; all storage files of the folder are read'
        return BagFiles(found, _compression_of(found[0]), {}, (note,))
    try:
        return _from_metadata(path, metadata)
    except UnusableFile:
        raise
    except ValueError as error:
        raise UnusableFile(metadata, 'bad metadata', str(error).removeprefix(
            f'{metadata}: ')) from None
    except (KeyError, TypeError, AttributeError) as error:
        raise UnusableFile(
            metadata, 'bad metadata', 'is not the metadata of a bag: '
            f'{type(error).__name__} {one_line(error)}') from None


def _from_metadata(folder: Path, metadata: Path) -> BagFiles:
    information = read_yaml(metadata)[INFORMATION]
    paths = [_inside(folder, str(name), metadata) for name in information['relative_file_paths']]
    compression = str(information.get('compression_mode') or '').lower()
    if compression not in _COMPRESSIONS:
        raise ValueError(f'compression mode {compression!r} is not known')
    form = information.get('compression_format') or 'zstd'
    if compression not in ('', 'none') and form != 'zstd':
        raise ValueError(f'compression format {form!r} is not known')
    custom = {str(key): str(text) for key, text in (information.get('custom_data') or {}).items()}
    return BagFiles(paths, compression.replace('none', ''), custom)


def _inside(folder: Path, name: str, source: Path) -> Path:
    """Return a file of the bag; a path may name the bag's folder, as old versions did."""
    parts = PurePosixPath(name).parts
    path = folder / (parts[-1] if parts else '')
    leaves = not parts or parts[0] == '/' or '..' in parts or '\0' in name
    if leaves or not path.resolve().is_relative_to(folder.resolve()):
        raise UnusableFile(
            source, 'outside the folder', f"{name!r} leads out of the bag's folder")
    if not path.is_file():
        raise UnusableFile(path, 'missing', f'is missing, though {METADATA_FILE} names it')
    return path


def _compression_of(path: Path) -> str:
    return 'file' if path.name.endswith('.zstd') else ''


def by_number(path: Path) -> list[tuple[int, str]]:
    """Return a key that sorts ``frame_9`` before ``frame_10``."""
    return [(int(part), '') if part.isdigit() else (-1, part)
            for part in re.split(r'(\d+)', path.name)]
