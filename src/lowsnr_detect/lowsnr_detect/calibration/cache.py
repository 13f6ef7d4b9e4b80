"""Calibration curves on disk, one small file each, shared by all processes."""

from __future__ import annotations

from collections.abc import Mapping
import hashlib
import inspect
import json
import os
from pathlib import Path
import tempfile
from typing import Any
import warnings

import lowsnr_common.core
import lowsnr_detect.parts
import numpy as np


def default_folder() -> Path:
    """Return ``$XDG_CACHE_HOME/lowsnr``, or ``~/.cache/lowsnr`` if the variable is not set."""
    base = os.environ.get('XDG_CACHE_HOME')
    return (Path(base) if base else Path.home() / '.cache') / 'lowsnr'


def cache_key(cls: type, content: Mapping[str, Any]) -> str:
    """
    Return a key that differs for everything that the result depends on.

    Parameters
    ----------
    cls
        Class of the detector; its code, and that of the modules it uses, is part of the key.
    content
        All other values that the result depends on, of JSON types.

    """
    whole = {
        'detector': f'{cls.__module__}.{cls.__qualname__}', 'code': _code_digest(cls),
        'numpy': np.__version__.partition('.')[0], **content,
    }
    text = json.dumps(whole, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def load(folder: Path, key: str) -> dict[str, Any] | None:
    """Return the record of a key; None if there is none that can be read."""
    try:
        found = json.loads((folder / f'{key}.json').read_text(encoding='utf-8'))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None


def save(folder: Path, key: str, record: Mapping[str, Any]) -> None:
    """
    Write the record of a key in one step, so that other processes never read a part of it.

    A folder that cannot be written costs only the time to calibrate again, so that it is a
    warning.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(
                'w', dir=folder, prefix=f'{key}.', delete=False, encoding='utf-8') as file:
            json.dump(record, file, indent=1)
        os.replace(file.name, folder / f'{key}.json')
    except OSError as error:
        warnings.warn(f'{folder}: calibration not kept: {error.strerror}', stacklevel=2)


def _code_digest(cls: type) -> str:
    folders = [*lowsnr_common.core.__path__, *lowsnr_detect.parts.__path__]
    here = Path(__file__).parent
    files = {path for folder in map(Path, folders) for path in folder.glob('*.py')}
    files |= set(here.glob('*.py'))
    files |= {Path(inspect.getfile(base)) for base in cls.__mro__ if base is not object}
    digest = hashlib.sha256()
    for path in sorted(files, key=lambda path: (path.parent.name, path.name)):
        digest.update(path.read_bytes())
    return digest.hexdigest()
