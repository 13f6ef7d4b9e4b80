# SPDX-License-Identifier: Apache-2.0
"""
The identity of a study: every value and all code that its numbers follow from.

Nothing of it is listed by hand.  The values are those of the whole :class:`Study` with
everything nested in it; the code is that of every package that a run executes.
"""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Mapping
from dataclasses import fields
from dataclasses import is_dataclass
import functools
import hashlib
from importlib.metadata import version
from pathlib import Path
from typing import Any

import lowsnr_common
import lowsnr_detect
import lowsnr_eval.scoring
import lowsnr_eval.study
from lowsnr_eval.study.study import Study
import lowsnr_sensor
import lowsnr_track
import numpy as np

_PACKAGES = (
    lowsnr_common, lowsnr_sensor, lowsnr_detect, lowsnr_track, lowsnr_eval.scoring,
    lowsnr_eval.study)
_LIBRARIES = ('numpy', 'scipy', 'numba')


def identity(study: Study) -> dict[str, Any]:
    """
    Return the identity of a study, of JSON types.

    It has all values by their path, such as ``study.cases[0].evaluation.gate_cells``, the
    digest of the code, and the versions of the numerical libraries.

    Raises
    ------
    TypeError
        If the study holds a value of a type that has no canonical form.

    """
    return _software() | dict(_values('study', study))


def differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Return old and new value of every path at which two identities differ, in order."""
    return {path: (old.get(path), new.get(path)) for path in {**new, **old}
            if path not in old or path not in new or old[path] != new[path]}


@functools.cache
def code_digest() -> str:
    """Return a digest of the code that the numbers of a study come from."""
    files = sorted(
        (f'{package.__name__}/{path.relative_to(root).as_posix()}', path)
        for package in _PACKAGES for root in map(Path, package.__path__)
        for path in root.rglob('*.py')
        if path.parent.name != 'ros' and not path.stem.endswith('_node'))
    digest = hashlib.sha256()
    for name, path in files:
        digest.update(f'{name}\0{hashlib.sha256(path.read_bytes()).hexdigest()}\n'.encode())
    return digest.hexdigest()[:16]


@functools.cache
def _software() -> dict[str, Any]:
    return {'code': code_digest()} | {f'version of {name}': version(name) for name in _LIBRARIES}


def _values(path: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the path and the canonical form of every value within a value."""
    if is_dataclass(value) and not isinstance(value, type):
        yield f'{path}.class', f'{type(value).__module__}.{type(value).__qualname__}'
        for item in fields(value):
            yield from _values(f'{path}.{item.name}', getattr(value, item.name))
    elif isinstance(value, tuple | list):
        yield f'{path}.length', len(value)
        for n, item in enumerate(value):
            yield from _values(f'{path}[{n}]', item)
    elif isinstance(value, np.ndarray):
        digest = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        yield path, f'{value.dtype.str} {value.shape} {digest}'
    elif isinstance(value, float):
        yield path, repr(float(value))  # JSON has neither infinity nor NaN
    elif value is None or isinstance(value, bool | int | str):
        yield path, value
    else:
        raise TypeError(f'{path} = {value!r}: {type(value).__name__} has no canonical form')
