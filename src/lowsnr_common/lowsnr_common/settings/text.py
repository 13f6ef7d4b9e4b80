# SPDX-License-Identifier: Apache-2.0
"""Text from outside: YAML that is safe to load, and messages of one line."""

from __future__ import annotations

from collections.abc import Iterable
import difflib
import math
from pathlib import Path
from typing import Any

import yaml

_MOST_VALUES = 200_000  # in one text, with every alias written out
_MOST_LETTERS = 600
_MOST_DIGITS = 40
_WHOLE_NUMBER = 'tag:yaml.org,2002:int'
# What the YAML library raises for a date, a number or a tag that is malformed.
_NO_VALUE = (
    ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError)


def printable(text: object) -> str:
    r"""
    Return a text from outside as it is shown to people: in one line, nothing in it acts.

    Line breaks, terminal escapes, marks that change the direction of writing and all else that
    does not print is shown as Python writes it: ``\n``, ``\x1b``, ``\u202e``.
    """
    return ''.join(
        each if each.isprintable() else each.encode('unicode_escape').decode()
        for each in str(text))


def printable_lines(text: object) -> str:
    """Return a text whose lines are :func:`printable`; its line breaks are kept."""
    return '\n'.join(map(printable, str(text).split('\n')))


def cell_text(text: str) -> str:
    """Return a text that no spreadsheet takes for a formula."""
    return f"'{text}" if text.startswith(('=', '+', '-', '@')) else text


def one_line(message: object) -> str:
    """Return a message as one printable line; the middle of a long one is left out."""
    line = ' '.join(map(printable, str(message).split()))
    if len(line) <= _MOST_LETTERS:
        return line
    return f'{line[:_MOST_LETTERS // 2]} ... {line[-_MOST_LETTERS // 2:]}'


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the end of a message that offers the known name nearest to a misspelt one."""
    near = difflib.get_close_matches(name, list(known), n=1)
    return f'; did you mean {near[0]}?' if near else ''


def read_yaml(path: Path) -> Any:
    """
    Return the content of a YAML file, as :func:`load_yaml` does.

    Raises
    ------
    ValueError
        One line that names the file and says why it cannot be read.

    """
    try:
        return load_yaml(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise ValueError(f'{path}: cannot be read: {error.strerror}') from None
    except UnicodeDecodeError as error:
        raise ValueError(f'{path}: is not YAML: {error}') from None
    except ValueError as error:
        raise ValueError(f'{path}: {error}') from None


def load_yaml(text: str) -> Any:
    """
    Return the content of a YAML text: mappings, lists, texts and numbers, never other objects.

    Raises
    ------
    ValueError
        One line that says why the text is not YAML, or that it holds too much.

    """
    loader = yaml.SafeLoader('')
    try:
        loader = yaml.SafeLoader(text)
        node = loader.get_single_node()
        if node is None:
            return None
        if _size(node, {}) > _MOST_VALUES:
            raise ValueError('it holds too many values, or an alias that contains itself')
        return loader.construct_document(node)
    except (yaml.YAMLError, *_NO_VALUE) as error:
        raise ValueError(f'is not YAML: {one_line(error) or type(error).__name__}') from None
    finally:
        loader.dispose()


def _size(node: yaml.Node, sizes: dict[int, float]) -> float:
    """Return the number of values in a node, with every alias written out; inf for a cycle."""
    key = id(node)
    if key not in sizes:
        if node.tag == _WHOLE_NUMBER and len(node.value) > _MOST_DIGITS:
            raise ValueError(f'{node.value[:_MOST_DIGITS]}... is too long a number')
        sizes[key] = math.inf
        inner: list[yaml.Node] = []
        if isinstance(node, yaml.MappingNode):
            inner = [part for pair in node.value for part in pair]
        elif isinstance(node, yaml.SequenceNode):
            inner = node.value
        sizes[key] = 1 + sum(_size(part, sizes) for part in inner)
    return sizes[key]
