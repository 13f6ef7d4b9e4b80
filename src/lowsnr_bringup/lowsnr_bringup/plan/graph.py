"""
The node graph of a run: which nodes, in which namespaces, with which parameters.

Everything is checked here against the declared settings, before anything starts: ROS itself
ignores a misspelt parameter without a word.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lowsnr_bringup.bags.recording import RecorderSettings
from lowsnr_bringup.bags.replay import PlayerSettings
from lowsnr_common.settings.config import build_settings
from lowsnr_common.settings.config import declared_settings
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import NodeSettings
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_common.settings.node_settings import SimulationSettings
from lowsnr_common.settings.node_settings import TruthSettings
from lowsnr_common.settings.node_settings import ViewSettings
from lowsnr_detect.parts.registry import detector_class
from lowsnr_detect.parts.registry import DETECTORS
from lowsnr_sensor.conditioning.conditioner import ConditioningSettings
from lowsnr_track.pda_mmpf import PdaMmpf
import yaml

EVERY_NODE = '/**'
MANAGER = 'bringup'  # bring-up's own node
CONDITIONED = '/conditioned/'
SEEN = ('image_raw', 'ground_truth', 'ground_truth/odometry')
KEY = 'ros__parameters'
SETTINGS: dict[str, tuple[type, ...]] = {
    'sensor': (SimulationSettings,), 'tracker': (PdaMmpf,), 'evaluator': (RunSettings, Evaluation),
    'player': (PlayerSettings,), 'recorder': (RecorderSettings,),
    'conditioner': (ConditioningSettings, TruthSettings), 'viewer': (ViewSettings,)}


@dataclass(frozen=True)
class Node:
    """
    One process of the graph.

    A run goes on without one that is not ``needed``; a ``live`` one hears a camera itself.
    """

    name: str
    module: str
    namespace: str = ''
    arguments: tuple[str, ...] = ()
    remaps: tuple[str, ...] = ()
    needed: bool = True
    live: bool = False

    @property
    def source(self) -> bool:
        """Whether the frames come from it."""
        return self.name in ('sensor', 'player')

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
    if name in SETTINGS:
        return NodeSettings, *SETTINGS[name]
    return NodeSettings, DetectionSettings, detector_class(name.removesuffix('_detector'))


def known_nodes() -> list[str]:
    """Return the names of all nodes that could be part of a graph."""
    detector_class('sdt')  # has every detector register itself
    return [*SETTINGS, *(f'{name}_detector' for name in DETECTORS)]


def plan(
    detectors: Iterable[str], source: str = 'sensor', recorded: bool = False,
    conditioned: bool = False, viewed: bool = False, camera: str = '',
) -> list[Node]:
    """
    Return the nodes of a run, consumers first.

    One detector's chain stands at the root; of several each has a namespace of its name and
    takes the same frames.  The frames come from the sensor, from a player, or on the topic of a
    camera, which is no node of the run; a conditioner may stand between them and whoever takes
    them, a recorder beside all, a viewer beside each chain.
    """
    names = list(detectors)
    seen = _seen(conditioned, camera)
    moved, live = conditioned or bool(camera), bool(camera) and not conditioned
    nodes = [Node(
        'evaluator', 'lowsnr_eval.evaluator_node', remaps=seen if moved else (), live=live)]
    for name in names:
        space = f'/{name}' if len(names) > 1 else ''
        remaps = seen[:1] if space or moved else ()
        if viewed:
            nodes.append(Node('viewer', 'lowsnr_eval.viewer_node', space, remaps=seen,
                              needed=False, live=live))
        nodes.append(Node('tracker', 'lowsnr_track.tracker_node', space))
        nodes.append(Node(
            f'{name}_detector', 'lowsnr_detect.node.detector_node', space, (name,), remaps,
            live=live))
    if conditioned:
        nodes.append(Node(
            'conditioner', 'lowsnr_sensor.conditioner_node', live=bool(camera),
            remaps=(f'image_raw:={camera}',) if camera else ()))
    if recorded:  # before whoever hears a camera, which waits for nobody
        nodes.insert(0 if camera else len(nodes), Node(
            'recorder', 'lowsnr_bringup.recorder_node', live=bool(camera)))
    if camera:
        return nodes
    package = 'lowsnr_sensor' if source == 'sensor' else 'lowsnr_bringup'
    return [*nodes, Node(source, f'{package}.{source}_node')]


def _seen(conditioned: bool, camera: str) -> tuple[str, ...]:
    """Return where frames and truth are found by whoever looks at them."""
    names = {topic: f'{CONDITIONED if conditioned else "/"}{topic}' for topic in SEEN}
    if camera and not conditioned:
        names['image_raw'] = camera
    return tuple(f'{topic}:={name}' for topic, name in names.items())


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
        path: {KEY: {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in own.items() if value != ()}}
        for path, own in values.items()
    }
    return yaml.safe_dump(tree, sort_keys=True)
