"""Text from outside: YAML read without harm, and anything said in one line."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import yaml

# Values that a text may hold, each alias written out.
_MOST_VALUES = 200_000
_MOST_LETTERS = 600
_MOST_DIGITS = 40
_WHOLE_NUMBER = 'tag:yaml.org,2002:int'
# What the values of a text that is YAML may still raise: dates, numbers and tags that are none.
_NO_VALUE = (
    ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError)


def one_line(said: object) -> str:
    """Return what is said in one line that a terminal shows as it is, its middle left out."""
    words = ''.join(each if each.isprintable() else ' ' for each in str(said)).split()
    line = ' '.join(words)
    if len(line) <= _MOST_LETTERS:
        return line
    return f'{line[:_MOST_LETTERS // 2]} ... {line[-_MOST_LETTERS // 2:]}'


def read_yaml(path: Path) -> Any:
    """
    Return what a file of YAML holds, as :func:`load_yaml` does.

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
    Return what YAML holds: mappings, lists, texts and numbers, never other objects.

    Raises
    ------
    ValueError
        One line that says why it is not YAML, or too much of it.

    """
    loader = yaml.SafeLoader('')
    try:
        loader = yaml.SafeLoader(text)
        node = loader.get_single_node()
        if node is None:
            return None
        if _size(node, {}) > _MOST_VALUES:
            raise ValueError('its aliases name themselves, or it holds too many values')
        return loader.construct_document(node)
    except (yaml.YAMLError, *_NO_VALUE) as error:
        raise ValueError(f'is not YAML: {one_line(error) or type(error).__name__}') from None
    finally:
        loader.dispose()


def _size(node: yaml.Node, sizes: dict[int, float]) -> float:
    """Return the number of values in a node with each alias written out; inf within itself."""
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
