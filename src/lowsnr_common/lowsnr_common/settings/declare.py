# SPDX-License-Identifier: Apache-2.0
"""
How to declare a setting: one declaration serves Python, YAML, ROS parameters and validation.

A settings class is a frozen dataclass.  A field made by :func:`setting` is one value with its
documentation and bounds; a field whose type is itself a settings class is a group, and its values
are named ``group.value``::

    @dataclass(frozen=True, kw_only=True)
    class SensorModel:
        snr_db: float = setting(
            6.0, 'object SNR per cell and frame [dB]', ge=-20.0, le=60.0, live=True)

        def __post_init__(self):
            check_settings(self)

:func:`declared_settings` lists what a class declares; :mod:`lowsnr_common.settings.flat_values`
builds instances from values such as ``{'sensor.snr_db': 9.0}``.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field
from dataclasses import fields
from dataclasses import is_dataclass
from dataclasses import replace
import math
from types import MappingProxyType
from typing import Any
from typing import get_args
from typing import get_origin
from typing import get_type_hints
from typing import TypeVar

T = TypeVar('T')
_KEY = 'setting'
_FIXED = 'fixed'


def setting(
    default: Any,
    doc: str,
    *,
    ge: float | None = None,
    gt: float | None = None,
    le: float | None = None,
    lt: float | None = None,
    choices: Iterable[Any] | None = None,
    live: bool = False,
) -> Any:
    """
    Declare one setting as a dataclass field.

    Parameters
    ----------
    default
        Value if no other is given.
    doc
        Meaning and unit, one sentence; shown by ``ros2 param describe``.
    ge, gt, le, lt
        Bounds; for a tuple they hold for every element.
    choices
        The allowed values, if there are few.
    live
        Whether it can change while a node runs that supports that.

    """
    allowed = None if choices is None else tuple(choices)
    declared = {
        'doc': doc, 'ge': ge, 'gt': gt, 'le': le, 'lt': lt, 'choices': allowed, 'live': live}
    return field(default=default, metadata={_KEY: declared})


def fixed(cls: type[T]) -> T:
    """Declare a group of settings, none of which can change while a node runs."""
    made: T = field(default_factory=cls, metadata={_FIXED: True})
    return made


def check_settings(instance: Any) -> None:
    """
    Check every setting of an instance; call it in ``__post_init__``.

    Raises
    ------
    ValueError
        ``Class.field = value, must be ...`` for the first bad value.

    """
    for item in _declared(type(instance)).own:
        try:
            value = item.check(getattr(instance, item.name))
        except ValueError as error:
            raise ValueError(f'{type(instance).__name__}.{error}') from None
        object.__setattr__(instance, item.name, value)


def declared_settings(cls: type) -> Mapping[str, Setting]:
    """Return all settings of a class and of its groups by their full name."""
    return _declared(cls).settings


def setting_groups(cls: type) -> Mapping[str, type]:
    """Return the classes of the groups of a settings class by their names."""
    return _declared(cls).groups


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


@dataclass(frozen=True)
class _Declared:
    """What a settings class declares: its own settings, its groups, and all by full name."""

    own: tuple[Setting, ...]
    groups: Mapping[str, type]
    settings: Mapping[str, Setting]


_DECLARED: dict[type, _Declared] = {}  # a cache: resolving the annotations of a class is slow


def _declared(cls: type) -> _Declared:
    if cls not in _DECLARED:
        _DECLARED[cls] = _resolve(cls)
    return _DECLARED[cls]


def _resolve(cls: type) -> _Declared:
    kinds = get_type_hints(cls)
    own = tuple(
        Setting(item.name, kinds[item.name], item.default, **item.metadata[_KEY])
        for item in fields(cls) if _KEY in item.metadata)
    groups = {
        item.name: kinds[item.name] for item in fields(cls) if is_dataclass(kinds[item.name])}
    is_fixed = {item.name for item in fields(cls) if _FIXED in item.metadata}
    found = {item.name: item for item in own}
    for name, group in groups.items():
        for key, item in _declared(group).settings.items():
            full, live = f'{name}.{key}', item.live and name not in is_fixed
            found[full] = replace(item, name=full, live=live)
    return _Declared(own, groups, MappingProxyType(found))


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
