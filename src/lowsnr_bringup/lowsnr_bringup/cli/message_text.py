# SPDX-License-Identifier: Apache-2.0
"""Messages as the text that ``ros2 topic echo`` prints."""

from __future__ import annotations

import array
from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
import sys
from typing import Any

import numpy as np
import yaml

SEPARATOR = '---'
_SEQUENCES = (list, tuple, array.array, np.ndarray)


@dataclass(frozen=True)
class TextForm:
    """
    How much of a message is printed.

    Parameters
    ----------
    longest
        Longest array and text that are printed whole; None for any.
    arrays, texts
        Whether the content of arrays and of texts is printed, or only its length.
    flow
        Whether the YAML is in flow style, in one line.

    """

    longest: int | None = 128
    arrays: bool = True
    texts: bool = True
    flow: bool = False


def selected(message: Any, path: Sequence[str]) -> Any:
    """
    Return a field of a message, named by the fields on the way to it.

    Raises
    ------
    ValueError
        If there is no such field; names it, and those that there are.

    """
    for name in path:
        if name not in (fields := _fields(message)):
            known = f'{type(message).__name__} has {", ".join(fields)}' if fields else (
                f'{type(message).__name__} has no fields')
            raise ValueError(f"Invalid field '{'.'.join(path)}': {known}")
        message = getattr(message, name)
    return message


def yaml_text(message: Any, form: TextForm) -> str:
    """Return a message as YAML, the fields in the order of its definition."""
    return str(yaml.dump(
        _plain(message, form, ''), allow_unicode=True, width=sys.maxsize, sort_keys=False,
        default_flow_style=form.flow))


def csv_text(message: Any, form: TextForm) -> str:
    """Return all values of a message in one line, separated by commas."""
    return ','.join(_leaves(_plain(message, form, '')))


def field_text(value: Any, form: TextForm, as_csv: bool = False) -> str:
    """Return a message, or one value of it, as it is printed for one arrival."""
    if not _fields(value):
        return f'{value}\n{SEPARATOR}\n'
    return f'{csv_text(value, form)}\n' if as_csv else f'{yaml_text(value, form)}{SEPARATOR}\n'


def _fields(message: Any) -> Mapping[str, str]:
    """Return the types of a message's fields by name; nothing for what is not a message."""
    known = getattr(message, 'get_fields_and_field_types', None)
    return {} if known is None else known()


def _plain(value: Any, form: TextForm, kind: str) -> Any:
    """Return a value of a field of a type as dictionaries, lists, texts and numbers."""
    if fields := _fields(value):
        return {name: _plain(getattr(value, name), form, each) for name, each in fields.items()}
    if isinstance(value, bytes):
        value = value.decode('latin-1')
    elif isinstance(value, str):
        if not form.texts:
            return f'<string length: <{len(value)}>>'
    elif isinstance(value, _SEQUENCES):
        if not form.arrays:
            return _array_length(kind, len(value))
        cut = [_plain(each, form, '') for each in value[:form.longest]]
        return cut if len(cut) == len(value) else [*cut, '...']
    elif isinstance(value, np.generic):
        return value.item()
    if isinstance(value, str) and form.longest is not None and len(value) > form.longest:
        return f'{value[:form.longest]}...'
    return value


def _array_length(kind: str, length: int) -> str:
    """Return what stands for an array: its type, and its length where that may vary."""
    full = kind.replace('/', '/msg/')
    if kind.startswith('sequence<'):
        element, _, most = full[len('sequence<'):-1].partition(', ')
        return f'<sequence type: {element}{f"[{most}]" if most else ""}, length: {length}>'
    return f'<array type: {full}>'


def _leaves(plain: Any) -> list[str]:
    if isinstance(plain, dict):
        plain = list(plain.values())
    if isinstance(plain, list):
        return [leaf for each in plain for leaf in _leaves(each)]
    return [str(plain)]
