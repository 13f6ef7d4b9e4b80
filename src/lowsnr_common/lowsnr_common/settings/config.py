"""
Settings: one declaration serves Python, YAML, ROS parameters and validation.

A settings class is a frozen dataclass.  A field made by :func:`setting` is one
value with its documentation and bounds; a field whose type is itself a settings
class is a group, and its values are named ``group.value``::

    @dataclass(frozen=True, kw_only=True)
    class SensorModel:
        snr_db: float = setting(
            6.0, 'object SNR per cell and frame [dB]', ge=-20.0, le=60.0, live=True)

        def __post_init__(self):
            check_settings(self)

:func:`declared_settings` lists what a class declares, :func:`build_settings` makes an
instance of flat values ``{'sensor.snr_db': 9.0}``.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field
from dataclasses import fields
from dataclasses import is_dataclass
from dataclasses import replace
from types import MappingProxyType
from typing import Any
from typing import get_type_hints
from typing import TypeVar

from lowsnr_common.settings.declaration import Setting
from lowsnr_common.settings.text import did_you_mean

T = TypeVar('T')
_KEY = 'setting'
_FIXED = 'fixed'


@dataclass(frozen=True)
class _Declared:
    """What a settings class declares: its own settings, its groups, and all by full name."""

    own: tuple[Setting, ...]
    groups: Mapping[str, type]
    settings: Mapping[str, Setting]


_DECLARED: dict[type, _Declared] = {}  # resolving the annotations of a class is slow


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


def check_values(cls: type, values: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return flat values, each checked against its declaration.

    Raises
    ------
    ValueError
        For a key that is not declared (with the nearest one that is) or a bad value.

    """
    declared = declared_settings(cls)
    checked = {}
    for name, value in values.items():
        if name not in declared:
            raise ValueError(f'{name} is not a setting{did_you_mean(name, declared)}')
        checked[name] = declared[name].check(value)
    return checked


def build_settings(cls: type[T], values: Mapping[str, Any]) -> T:
    """
    Build an instance from flat values; a missing one has its default.

    Raises
    ------
    ValueError
        For an unknown key or a bad value, by name.

    """
    return _build(cls, check_values(cls, values))


def changed(instance: T, values: Mapping[str, Any]) -> T:
    """
    Return a copy of an instance with new flat values; names of other classes are ignored.

    Raises
    ------
    ValueError
        For a bad value, by name, or values that contradict each other.

    """
    flat = flat_values(instance)
    own = {name: value for name, value in values.items() if name in flat}
    return build_settings(type(instance), {**flat, **own})


def flat_values(instance: Any) -> dict[str, Any]:
    """Return the values of an instance by their full names, tuples as lists."""
    flat = {}
    for name in declared_settings(type(instance)):
        value = instance
        for part in name.split('.'):
            value = getattr(value, part)
        flat[name] = list(value) if isinstance(value, tuple) else value
    return flat


def flatten(tree: Mapping[str, Any], prefix: str = '') -> dict[str, Any]:
    """Return nested mappings, as YAML has them, as flat ``group.value`` names."""
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        name = f'{prefix}{key}'
        if isinstance(value, Mapping):
            flat.update(flatten(value, f'{name}.'))
        else:
            flat[name] = value
    return flat


def _build(cls: type[T], values: Mapping[str, Any]) -> T:
    own = {item.name for item in _declared(cls).own}
    arguments: dict[str, Any] = {key: value for key, value in values.items() if key in own}
    for name, group in _declared(cls).groups.items():
        start = f'{name}.'
        inner = {key[len(start):]: val for key, val in values.items() if key.startswith(start)}
        arguments[name] = _build(group, inner)
    return cls(**arguments)


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
