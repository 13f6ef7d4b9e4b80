# SPDX-License-Identifier: Apache-2.0
"""Instances of settings classes from and to flat values, such as ``{'sensor.snr_db': 9.0}``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from typing import TypeVar

from lowsnr_common.settings.declare import declared_settings
from lowsnr_common.settings.declare import setting_groups
from lowsnr_common.settings.text import did_you_mean

T = TypeVar('T')


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
    arguments: dict[str, Any] = {key: value for key, value in values.items() if '.' not in key}
    for name, group in setting_groups(cls).items():
        start = f'{name}.'
        inner = {key[len(start):]: val for key, val in values.items() if key.startswith(start)}
        arguments[name] = _build(group, inner)
    return cls(**arguments)
