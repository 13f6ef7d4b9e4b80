"""
The node graph of a run: which nodes, in which namespaces, with which parameters.

Everything is checked here against the declared settings, before anything starts: ROS itself
ignores a misspelt parameter without a word.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping
from dataclasses import dataclass
import difflib
from pathlib import Path
from typing import Any

from lowsnr_detect.registry import detector_class
from lowsnr_detect.registry import DETECTORS
from lowsnr_eval.run_settings import RunSettings
from lowsnr_eval.scoring import Evaluation
from lowsnr_sensor.config import build_settings
from lowsnr_sensor.config import check_values
from lowsnr_sensor.config import declared_settings
from lowsnr_sensor.config import flatten
from lowsnr_sensor.node_settings import DetectionSettings
from lowsnr_sensor.node_settings import NodeSettings
from lowsnr_sensor.node_settings import SimulationSettings
from lowsnr_track.pda_mmpf import PdaMmpf
import yaml

CONFIG_FILES = ('common.yaml', 'detectors.yaml', 'tracker.yaml', 'evaluator.yaml')
EVERY_NODE = '/**'
_KEY = 'ros__parameters'


@dataclass(frozen=True)
class Node:
    """One process of the graph."""

    name: str
    module: str
    namespace: str = ''
    arguments: tuple[str, ...] = ()
    remaps: tuple[str, ...] = ()

    @property
    def path(self) -> str:
        """Fully qualified name."""
        return f'{self.namespace}/{self.name}'

    @property
    def label(self) -> str:
        """Name for people, logs and files."""
        return self.path.strip('/').replace('/', '.')


def settings_classes(name: str) -> tuple[type, ...]:
    """Return the settings classes that declare the parameters of a node."""
    if name == 'sensor':
        return NodeSettings, SimulationSettings
    if name == 'tracker':
        return NodeSettings, PdaMmpf
    if name == 'evaluator':
        return NodeSettings, RunSettings, Evaluation
    return NodeSettings, DetectionSettings, detector_class(name.removesuffix('_detector'))


def known_nodes() -> list[str]:
    """Return the names of all nodes that could be part of a graph."""
    detector_class('sdt')  # has every detector register itself
    return ['sensor', *(f'{name}_detector' for name in DETECTORS), 'tracker', 'evaluator']


def plan(detectors: Iterable[str]) -> list[Node]:
    """
    Return the nodes of a run, consumers first.

    One detector's chain stands at the root; of several each has a namespace of its name and
    takes the same frames.
    """
    names = list(detectors)
    nodes = [Node('evaluator', 'lowsnr_eval.evaluator_node')]
    for name in names:
        space = f'/{name}' if len(names) > 1 else ''
        remaps = ('image_raw:=/image_raw',) if space else ()
        nodes.append(Node('tracker', 'lowsnr_track.tracker_node', space))
        nodes.append(Node(
            f'{name}_detector', 'lowsnr_detect.detector_node', space, (name,), remaps))
    return [*nodes, Node('sensor', 'lowsnr_sensor.sensor_node')]


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
        try:
            tree = yaml.safe_load(path.read_text(encoding='utf-8')) or {}
        except OSError as error:
            raise ValueError(f'{path}: cannot be read: {error.strerror}') from None
        except (yaml.YAMLError, UnicodeDecodeError) as error:
            raise ValueError(f'{path}: not YAML: {" ".join(str(error).split())}') from None
        if not isinstance(tree, Mapping):
            raise ValueError(f'{path}: must be a mapping of nodes to {_KEY}')
        for section, body in tree.items():
            try:
                name, values = _check_section(str(section), body)
            except ValueError as error:
                raise ValueError(f'{path}: {section}: {error}') from None
            config.setdefault(name, {}).update(values)
    return config


def _check_section(section: str, body: Any) -> tuple[str, dict[str, Any]]:
    name = section if section == EVERY_NODE else section.removeprefix('/**/').strip('/')
    if name != EVERY_NODE and name not in known_nodes():
        raise ValueError(f'is not {EVERY_NODE} or /**/NODE with NODE one of '
                         + ', '.join(known_nodes()))
    if not isinstance(body, Mapping) or set(body) != {_KEY} or not isinstance(body[_KEY], Mapping):
        raise ValueError(f'must hold {_KEY} and nothing else')
    return name, _check_keys(name, flatten(body[_KEY]))


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
        raise ValueError(f'--set {text}: must read NODE.PARAMETER=VALUE')
    names = {name: f'{name}_detector' for name in detectors} | {
        name: name for name in ('sensor', 'tracker', 'evaluator')}
    if node not in names:
        raise ValueError(f'--set {text}: {node} is not one of {", ".join(names)}')
    try:
        parsed = yaml.safe_load(value)
        return names[node], _check_keys(names[node], {key: parsed})
    except (ValueError, yaml.YAMLError) as error:
        raise ValueError(f'--set {text}: {" ".join(str(error).split())}') from None


def parameters(
    nodes: Iterable[Node], *layers: Mapping[str, Mapping[str, Any]],
) -> dict[str, dict[str, Any]]:
    """
    Return the parameters of every node of a run, later layers over earlier ones.

    Parameters
    ----------
    nodes
        The nodes of the run.
    layers
        Values by ``'/**'`` or node name; within a layer a node's own win.  A value under
        ``'/**'`` reaches the nodes that declare it.

    Returns
    -------
    dict
        Values by full node name.

    """
    result = {}
    for node in nodes:
        classes = settings_classes(node.name)
        declared = {key for cls in classes for key in declared_settings(cls)}
        values: dict[str, Any] = {}
        for layer in layers:
            for section in (EVERY_NODE, node.name, node.path):
                values |= {k: v for k, v in layer.get(section, {}).items() if k in declared}
        result[node.path] = values
    return result


def build(cls: type, values: Mapping[str, Any], label: str) -> Any:
    """Make a node's settings of its parameters; ValueError names the node too."""
    declared = declared_settings(cls)
    try:
        return build_settings(cls, {k: v for k, v in values.items() if k in declared})
    except ValueError as error:
        raise ValueError(f'{label}: {error}') from None


def to_yaml(values: Mapping[str, Mapping[str, Any]]) -> str:
    """Return parameters as a ROS parameter file; empty lists, which ROS cannot read, left out."""
    tree = {
        path: {_KEY: {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in own.items() if value != ()}}
        for path, own in values.items()
    }
    return yaml.safe_dump(tree, sort_keys=True)
