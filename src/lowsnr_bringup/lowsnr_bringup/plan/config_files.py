"""
The parameter files and the settings of the command line, checked before anything starts.

ROS itself ignores a misspelt parameter without a word.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping
import difflib
from pathlib import Path
from typing import Any

from lowsnr_bringup.plan.graph import EVERY_NODE
from lowsnr_bringup.plan.graph import KEY
from lowsnr_bringup.plan.graph import known_nodes
from lowsnr_bringup.plan.graph import SETTINGS
from lowsnr_bringup.plan.graph import settings_classes
from lowsnr_common.settings.config import check_values
from lowsnr_common.settings.config import declared_settings
from lowsnr_common.settings.config import flatten
from lowsnr_common.settings.text import load_yaml
from lowsnr_common.settings.text import one_line
from lowsnr_common.settings.text import read_yaml

CONFIG_FILES = (
    'common.yaml', 'conditioner.yaml', 'detectors.yaml', 'tracker.yaml', 'evaluator.yaml')


def load_config(folder: Path) -> dict[str, dict[str, Any]]:
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
    config: dict[str, dict[str, Any]] = {}
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


def _check_section(section: str, body: Any) -> tuple[str, dict[str, Any]]:
    name = section if section == EVERY_NODE else section.removeprefix('/**/').strip('/')
    if name != EVERY_NODE and name not in known_nodes():
        raise ValueError(f'is not {EVERY_NODE} or /**/NODE with NODE one of '
                         + ', '.join(known_nodes()))
    if not isinstance(body, Mapping) or set(body) != {KEY} or not isinstance(body[KEY], Mapping):
        raise ValueError(f'must hold {KEY} and nothing else')
    return name, _check_keys(name, flatten(body[KEY]))


def _check_keys(name: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Check values against the classes that declare them; ``/**`` means those of any node."""
    names = known_nodes() if name == EVERY_NODE else [name]
    classes = {cls for node in names for cls in settings_classes(node)}
    declared = {key for cls in classes for key in declared_settings(cls)}
    checked = {}
    for key, value in values.items():
        if key not in declared:
            near = difflib.get_close_matches(key, declared, n=1)
            hint = f'; did you mean {near[0]}?' if near else ''
            raise ValueError(f'{key} is not a parameter of this node{hint}')
        for cls in classes:
            if key in declared_settings(cls):
                checked.update(check_values(cls, {key: value}))
    return checked


def parse_override(text: str, detectors: Iterable[str]) -> tuple[str, dict[str, Any]]:
    """
    Read ``NODE.PARAMETER=VALUE``, where a detector's name stands for its node.

    Raises
    ------
    ValueError
        One line that names what does not fit.

    """
    target, equals, value = text.partition('=')
    node, dot, key = target.partition('.')
    if not (equals and dot and key):
        raise ValueError(f'--set {one_line(text)}: must read NODE.PARAMETER=VALUE')
    names = {name: f'{name}_detector' for name in detectors} | {
        name: name for name in SETTINGS}
    if node not in names:
        raise ValueError(
            f'--set {one_line(text)}: {one_line(node)} is not one of {", ".join(names)}')
    try:
        return names[node], _check_keys(names[node], {key: load_yaml(value)})
    except ValueError as error:
        raise ValueError(f'--set {one_line(text)}: {one_line(error)}') from None
