# SPDX-License-Identifier: Apache-2.0
"""The parameter files and ``--set``: every section, key and value is checked."""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Iterator
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lowsnr_bringup.plan.graph import EVERY_NODE
from lowsnr_bringup.plan.graph import KEY
from lowsnr_bringup.plan.graph import KINDS
from lowsnr_bringup.plan.graph import known_nodes
from lowsnr_bringup.plan.graph import Layer
from lowsnr_bringup.plan.graph import merged
from lowsnr_bringup.plan.graph import node_of
from lowsnr_bringup.plan.graph import settings_classes
from lowsnr_bringup.plan.graph import Values
from lowsnr_common.settings.declare import declared_settings
from lowsnr_common.settings.flat_values import flatten
from lowsnr_common.settings.text import did_you_mean
from lowsnr_common.settings.text import load_yaml
from lowsnr_common.settings.text import one_line
from lowsnr_common.settings.text import read_yaml
import yaml

CONFIG_FILES = (
    'common.yaml', 'conditioner.yaml', 'detectors.yaml', 'tracker.yaml', 'evaluator.yaml')


def load_config(folder: Path) -> Layer:
    """
    Read the parameter files and check every section, key and value.

    Parameters
    ----------
    folder
        Folder with ``common.yaml`` and the others.

    Returns
    -------
    dict
        Flat values by section: ``'/**'`` or the name of a node.

    Raises
    ------
    ValueError
        One line that names file, section, key and what is allowed.

    """
    config: dict[str, Values] = {}
    for path in (folder / name for name in CONFIG_FILES):
        tree = read_yaml(path) or {}
        if not isinstance(tree, Mapping):
            raise ValueError(f'{path}: must be a mapping of nodes to {KEY}')
        for section, body in tree.items():
            try:
                name, values = _check_section(str(section), body)
            except ValueError as error:
                raise ValueError(f'{path}: {one_line(f"{section}: {error}")}') from None
            config.setdefault(name, {}).update(values)
    return config


def _check_section(section: str, body: Any) -> tuple[str, Values]:
    name = section if section == EVERY_NODE else section.removeprefix('/**/').strip('/')
    if name != EVERY_NODE and name not in known_nodes():
        raise ValueError(f'is not {EVERY_NODE} or /**/NODE with NODE one of '
                         + ', '.join(known_nodes()))
    if not isinstance(body, Mapping) or set(body) != {KEY} or not isinstance(body[KEY], Mapping):
        raise ValueError(f'must hold {KEY} and nothing else')
    return name, _check_values(name, flatten(body[KEY]))


def _owners(key: str) -> str:
    """Return which nodes have a parameter that another one lacks."""
    found = [node for node in known_nodes() if any(
        key in declared_settings(cls) for cls in settings_classes(node))]
    return f', but of {", ".join(found)}' if found else ''


def _check_values(name: str, values: Mapping[str, Any]) -> Values:
    """Return values as their declared types; ``/**`` may set what any node declares."""
    names = known_nodes() if name == EVERY_NODE else [name]
    classes = dict.fromkeys(cls for node in names for cls in settings_classes(node))
    declared = [(key, item) for cls in classes for key, item in declared_settings(cls).items()]
    known = {key for key, _ in declared}
    for key in values:
        if key not in known:
            raise ValueError(
                f'{key} is not a parameter of this node'
                + (did_you_mean(key, known) or _owners(key)))
    return {key: item.check(values[key]) for key, item in declared if key in values}


def load_overrides(
    given: Iterable[str] | Mapping[str, Any], detectors: Iterable[str],
) -> Layer:
    """
    Return the values that override all others, by node.

    Parameters
    ----------
    given
        Texts ``NODE.PARAMETER=VALUE`` of ``--set``, or values by ``NODE.PARAMETER``; ``all``
        stands for all nodes.
    detectors
        Detectors of the run, whose names stand for their nodes.

    Raises
    ------
    ValueError
        One line that names what is wrong.

    """
    names = {name: node_of(name) for name in detectors} | {name: name for name in KINDS} | {
        'all': EVERY_NODE}
    layer: dict[str, Values] = {}
    for text in given:
        label = f'{"settings" if isinstance(given, Mapping) else "--set"} {one_line(text)}'
        try:
            target, value = (
                (text, given[text]) if isinstance(given, Mapping) else _parsed(text))
            node, values = _override(str(target), value, names)
        except ValueError as error:
            raise ValueError(f'{label}: {one_line(error)}') from None
        layer.setdefault(node, {}).update(values)
    return layer


def describe_parameters(
    files: Layer, detectors: Iterable[str],
) -> Iterator[tuple[str, Any, str, str]]:
    """
    Yield what can be overridden: ``NODE.PARAMETER``, its value, what is allowed, its meaning.

    Parameters
    ----------
    files
        What :func:`load_config` returns.
    detectors
        Detectors whose parameters are described beside those of all other nodes.

    """
    names = {name: node_of(name) for name in detectors} | {name: name for name in KINDS}
    for label, node in names.items():
        values = merged(node, [files])
        for cls in reversed(settings_classes(node)):  # what is common to all nodes comes last
            for key, item in declared_settings(cls).items():
                yield f'{label}.{key}', values.get(key, item.default), item.allowed(), item.doc


def _parsed(text: str) -> tuple[str, Any]:
    target, equals, value = text.partition('=')
    if not equals:
        raise ValueError('must read NODE.PARAMETER=VALUE')
    return target, load_yaml(value)


def _override(target: str, value: Any, names: Mapping[str, str]) -> tuple[str, Values]:
    """Return the node and the checked value of ``NODE.PARAMETER``."""
    node, _, key = target.partition('.')
    if not key:
        raise ValueError('must name NODE.PARAMETER')
    if node not in names:
        raise ValueError(f'{node} is not one of {", ".join(names)}{did_you_mean(node, names)}')
    return names[node], _check_values(names[node], {key: value})


def to_yaml(values: Mapping[str, Mapping[str, Any]]) -> str:
    """Return parameters as a ROS parameter file, without empty lists, which ROS cannot read."""
    tree = {
        path: {KEY: {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in own.items() if value not in ((), [])}}
        for path, own in values.items()
    }
    return yaml.safe_dump(tree, sort_keys=True)
