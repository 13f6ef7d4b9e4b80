# SPDX-License-Identifier: Apache-2.0
"""Calibration curves on disk, one small file each, shared by all processes."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Mapping
import hashlib
import inspect
import json
import os
from pathlib import Path
import sys
from typing import Any
from uuid import uuid4

import lowsnr_common.core
import lowsnr_common.noise
import lowsnr_detect.decisions
import lowsnr_detect.grid
import lowsnr_detect.parts
import numpy as np

Warn = Callable[[str], None]


def default_folder() -> Path:
    """
    Return ``$XDG_CACHE_HOME/lowsnr``, or ``~/.cache/lowsnr`` if the variable is not set.

    A user without a home, as a container may have, gets ``/.cache/lowsnr``.
    """
    base = os.environ.get('XDG_CACHE_HOME')
    home = os.path.expanduser('~')  # which returns '~' where there is none
    return (Path(base) if base else Path('/', '' if home == '~' else home, '.cache')) / 'lowsnr'


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


def load(folder: Path, key: str, warn: Warn) -> dict[str, Any] | None:
    """
    Return the record of a key, or None if there is none.

    A file that does not hold what :func:`save` wrote is not used; ``warn`` receives a line that
    names it.
    """
    path = _path(folder, key)
    try:
        found = json.loads(path.read_text(encoding='utf-8'))
        if found['seal'] == _seal(key, found['record']):
            return dict(found['record'])
        fault = 'its values are not those that were written'
    except FileNotFoundError:
        return None
    except OSError as error:
        fault = str(error.strerror)
    except (ValueError, LookupError, TypeError, RecursionError):
        fault = 'it is not a calibration'
    warn(f'{path}: cannot be used: {fault}; the calibration is made again')
    return None


def save(folder: Path, key: str, record: Mapping[str, Any], warn: Warn) -> None:
    """
    Write the record of a key in one step, so that other processes never read a part of it.

    A folder that cannot be written costs only the time to calibrate again; ``warn`` receives a
    line that names the file.
    """
    path = _path(folder, key)
    text = json.dumps({'seal': _seal(key, record), 'record': record}, indent=1, allow_nan=False)
    draft = path.with_suffix(f'.{uuid4().hex}.tmp')
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        try:
            with draft.open('x', encoding='utf-8') as file:
                file.write(text)
            draft.replace(path)
        finally:
            draft.unlink(missing_ok=True)
    except OSError as error:
        warn(f'{path}: the calibration is not kept: {error.strerror}')


def _path(folder: Path, key: str) -> Path:
    return folder / f'{key}.json'


def _seal(key: str, record: Mapping[str, Any]) -> str:
    """Return a digest of a record and the key that it belongs to."""
    text = json.dumps([key, record], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def code_files(cls: type) -> set[Path]:
    """Return the modules that the result of a calibration depends on."""
    modules = (
        lowsnr_common.core, lowsnr_common.noise, lowsnr_detect.parts, lowsnr_detect.grid,
        lowsnr_detect.decisions)
    folders = [Path(__file__).parent, *(Path(each.__path__[0]) for each in modules)]
    files = {path for folder in folders for path in folder.glob('*.py')}
    # The classes that it is made from, and those of other detectors that its module uses.
    module = sys.modules[cls.__module__]
    used = [
        each for each in vars(module).values()
        if inspect.isclass(each) and each.__module__.startswith('lowsnr_detect.detectors.')]
    return files | {
        Path(inspect.getfile(each)) for each in (*cls.__mro__, *used) if each is not object}


def _code_digest(cls: type) -> str:
    digest = hashlib.sha256()
    for path in sorted(code_files(cls), key=lambda path: (path.parent.name, path.name)):
        digest.update(path.read_bytes())
    return digest.hexdigest()
