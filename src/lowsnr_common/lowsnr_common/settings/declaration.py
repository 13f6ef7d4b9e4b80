"""One declared setting: the values that it accepts, and their description."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
import math
from typing import Any
from typing import get_args
from typing import get_origin


@dataclass(frozen=True)
class Setting:
    """
    One declared setting.

    ``kind`` is its type, ``doc`` its meaning and unit; ``ge``, ``gt``, ``le`` and ``lt`` are the
    bounds (of every element of a tuple); a ``live`` setting can change while a node runs.
    """

    name: str
    kind: Any
    default: Any
    doc: str
    ge: float | None
    gt: float | None
    le: float | None
    lt: float | None
    choices: tuple[Any, ...] | None
    live: bool

    def allowed(self) -> str:
        """Return a description of the values that the setting accepts."""
        if self.choices is not None:
            return 'one of ' + ', '.join(map(repr, self.choices))
        noun = _kind_name(self.kind)
        if all(bound is None for bound in (self.ge, self.gt, self.le, self.lt)):
            return f'a {noun}'
        low = f'({"-inf" if self.gt is None else self.gt}' if self.ge is None else f'[{self.ge}'
        high = f'{"inf" if self.lt is None else self.lt})' if self.le is None else f'{self.le}]'
        return f'a {noun} in {low}, {high}'

    def check(self, value: Any) -> Any:
        """
        Return the value as the setting's type.

        Raises
        ------
        ValueError
            If the value is of another type or out of bounds; names the allowed ones.

        """
        converted = _convert(value, self.kind)
        items = converted if isinstance(converted, tuple) else (converted,)
        if converted is None or not all(self._holds(item) for item in items):
            raise ValueError(f'{self.name} = {value!r}, must be {self.allowed()}')
        return converted

    def _holds(self, item: Any) -> bool:
        return (
            (self.choices is None or item in self.choices)
            and (self.ge is None or item >= self.ge)
            and (self.gt is None or item > self.gt)
            and (self.le is None or item <= self.le)
            and (self.lt is None or item < self.lt)
        )


def _convert(value: Any, kind: Any) -> Any:
    """Return the value as ``kind``, or None if it is of another type."""
    if get_origin(kind) is tuple:
        if isinstance(value, str) or not isinstance(value, Iterable):
            return None
        items = tuple(_convert(item, get_args(kind)[0]) for item in value)
        return None if any(item is None for item in items) else items
    if type(value) is int and value.bit_length() > 63:  # more than a ROS parameter can hold
        return None
    if kind is float and isinstance(value, (int, float)) and not isinstance(value, bool):
        return float(value) if math.isfinite(value) else None
    return value if type(value) is kind else None


def _kind_name(kind: Any) -> str:
    if get_origin(kind) is tuple:
        return f'list of {_kind_name(get_args(kind)[0])}s'
    names: dict[Any, str] = {float: 'number', int: 'whole number', str: 'text'}
    return names.get(kind, 'truth value (true or false)')
