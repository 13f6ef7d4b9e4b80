# SPDX-License-Identifier: Apache-2.0
"""
The nodes of a run: every kind of node, which of them a run starts, and how they are connected.

The modules of this folder check everything against the declared settings before anything
starts, because ROS ignores a misspelt parameter without a warning.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from typing import TypeVar

from lowsnr_common.settings.declare import declared_settings
from lowsnr_common.settings.flat_values import build_settings
from lowsnr_common.settings.node_settings import CameraFrameSettings
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import FrameSettings
from lowsnr_common.settings.node_settings import NodeSettings
from lowsnr_common.settings.node_settings import PlayerSettings
from lowsnr_common.settings.node_settings import RecorderSettings
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_common.settings.node_settings import SimulationSettings
from lowsnr_common.settings.node_settings import ViewSettings
from lowsnr_detect.parts.registry import detector_class
from lowsnr_detect.parts.registry import DETECTORS
from lowsnr_sensor.conditioning.conditioner import ConditioningSettings
from lowsnr_track.pda_mmpf import PdaMmpf

T = TypeVar('T')
Values = dict[str, Any]  # parameters by full name, such as 'sensor.snr_db'
Layer = Mapping[str, Mapping[str, Any]]  # values by section: EVERY_NODE or the name of a node
EVERY_NODE = '/**'
MANAGER = 'bringup'  # the node of bring-up itself
CHAIN = 'chain'  # the process of conditioner, detectors and trackers that share one
CONDITIONED = '/conditioned/'
KEY = 'ros__parameters'
_TRUTH = ('ground_truth:=/ground_truth', 'ground_truth/odometry:=/ground_truth/odometry')
_DETECTOR = '_detector'  # the end of the name of a detector's node
_TILE, _MERGER = 'lowsnr_detect.tiles.tile_node', 'lowsnr_detect.tiles.merger_node'


@dataclass(frozen=True)
class NodeKind:
    """The module that a node runs, and the classes that declare its parameters."""

    module: str
    settings: tuple[type, ...]


KINDS = {
    'sensor': NodeKind('lowsnr_sensor.sensor_node', (SimulationSettings,)),
    'player': NodeKind('lowsnr_bringup.player_node', (PlayerSettings,)),
    'conditioner': NodeKind(
        'lowsnr_sensor.conditioner_node', (CameraFrameSettings, ConditioningSettings)),
    'tracker': NodeKind('lowsnr_track.tracker_node', (FrameSettings, PdaMmpf)),
    'viewer': NodeKind('lowsnr_eval.viewer_node', (ViewSettings, FrameSettings)),
    'evaluator': NodeKind(
        'lowsnr_eval.evaluator_node', (RunSettings, Evaluation, FrameSettings)),
    'recorder': NodeKind('lowsnr_bringup.recorder_node', (RecorderSettings,)),
}


def node_kind(name: str) -> NodeKind:
    """Return the kind of the node of a name; the node of detector ``sdt`` is ``sdt_detector``."""
    return KINDS.get(name) or NodeKind(
        'lowsnr_detect.node.detector_node',
        (FrameSettings, DetectionSettings, detector_class(name.removesuffix(_DETECTOR))))


def settings_classes(name: str) -> tuple[type, ...]:
    """Return the settings classes that declare the parameters of a node."""
    return NodeSettings, *node_kind(name).settings


def known_nodes() -> list[str]:
    """Return the names of all nodes that can be part of a graph."""
    detector_class('sdt')  # makes every detector register itself
    return [*KINDS, *map(node_of, DETECTORS)]


def node_of(detector: str) -> str:
    """Return the name of a detector's node."""
    return f'{detector}{_DETECTOR}'


@dataclass(frozen=True)
class Node:
    """
    One node of the graph; nodes with the same ``process`` share one, any other has its own.

    A run goes on without a node that is not ``needed``.  A ``live`` node subscribes to a camera.
    """

    name: str
    module: str
    namespace: str = ''
    arguments: tuple[str, ...] = ()
    remaps: tuple[str, ...] = ()
    needed: bool = True
    live: bool = False
    process: str = ''

    @property
    def source(self) -> bool:
        """Whether the node publishes the frames of the run."""
        return self.name in ('sensor', 'player')

    @property
    def takes_raw(self) -> bool:
        """Whether the node takes frames of a camera, recorded or live, as they are."""
        return self.live or self.name == 'conditioner'

    @property
    def detector(self) -> bool:
        """Whether the node publishes what a detector declares."""
        return self.name.endswith(_DETECTOR)

    @property
    def tile(self) -> bool:
        """Whether the node runs a detector on a tile of the frame."""
        return self.module == _TILE

    @property
    def merges(self) -> bool:
        """Whether the node is that of a detector and merges what its tiles find."""
        return self.module == _MERGER

    @property
    def section(self) -> str:
        """Return the section of its parameters; a tile has those of its detector's node."""
        return node_of(self.arguments[0]) if self.arguments else self.name

    @property
    def path(self) -> str:
        """Fully qualified name."""
        return f'{self.namespace}/{self.name}'

    @property
    def enclave(self) -> str:
        """Security enclave, which is that of its process."""
        return f'/{self.process}' if self.process else self.path

    @property
    def label(self) -> str:
        """Name for people, logs and files."""
        return self.path.strip('/').replace('/', '.')


def run_nodes(
    detectors: Sequence[str], source: str = 'sensor', *, camera: str = '',
    conditioned: bool = False, recorded: bool = False, viewed: bool = False,
    composed: bool = False, tiles: int = 1,
) -> list[Node]:
    """
    Return the nodes of a run, subscribers before publishers.

    Parameters
    ----------
    detectors
        Names of the detectors.  The chain of a single one has no namespace; of several, each
        chain has a namespace of its name, and all take the same frames.
    source
        The node that publishes the frames: 'sensor' or 'player'.
    camera
        Topic of the camera that publishes the frames instead; it is no node of the run.
    conditioned, recorded, viewed
        Whether there is a conditioner between the frames and their subscribers, a recorder of
        every topic, and a viewer in each chain.
    composed
        Whether conditioner, detectors and trackers share one process.
    tiles
        Nodes that share the work of each detector; of several, its own node is the merger.

    """
    live, several = bool(camera), len(detectors) > 1
    raw = (f'image_raw:={camera or "/image_raw"}',)
    info = (f'camera_info:={CONDITIONED}camera_info',) * conditioned
    frames = (f'image_raw:={CONDITIONED}image_raw', *info) if conditioned else raw
    own = raw * live  # of nodes without a namespace
    shared = {'process': CHAIN} if composed else {}
    nodes = [_node('evaluator', remaps=(*own, *info), live=live)]
    for name in detectors:
        space = f'/{name}' * several
        if viewed:
            nodes.append(_node(
                'viewer', space, remaps=(*raw, *_TRUTH, *info), needed=False, live=live))
        nodes.append(_node('tracker', space, remaps=info, **shared))
        reads: Values = {'live': live and not conditioned,
                         'remaps': frames if several or conditioned or live else (), **shared}
        if tiles > 1:
            nodes.append(Node(node_of(name), _MERGER, space, arguments=(name,)))
            nodes += [Node(f'{name}_{number}', _TILE, space, (name, str(number)), **reads)
                      for number in range(1, tiles + 1)]
        else:
            nodes.append(_node(node_of(name), space, arguments=(name,), **reads))
    if conditioned:
        nodes.append(_node('conditioner', remaps=own, live=live, **shared))
    if recorded:  # a camera waits for no subscriber, so that its recorder starts first
        nodes.insert(0 if camera else len(nodes), _node('recorder', live=live))
    return nodes if camera else [*nodes, _node(source)]


def _node(name: str, namespace: str = '', **how: Any) -> Node:
    return Node(name, node_kind(name).module, namespace, **how)


def parameters(nodes: Iterable[Node], *layers: Layer) -> dict[str, Values]:
    """Return the parameters of every node by its full name, as :func:`merged` merges them."""
    return {node.path: merged(node.section, layers, node.name) for node in nodes}


def merged(section: str, layers: Iterable[Layer], name: str = '') -> Values:
    """
    Return the parameters of a node.

    Parameters
    ----------
    section
        Section of the node, which is its name but for a tile.
    layers
        A later layer wins over an earlier one.  Within a layer the node's own section wins over
        ``'/**'``, whose values reach the nodes that declare them.
    name
        Name of the node, for a section of its own besides.

    """
    declared = {key for cls in settings_classes(section) for key in declared_settings(cls)}
    return {
        key: value for layer in layers for each in (EVERY_NODE, section, name)
        for key, value in layer.get(each, {}).items() if key in declared}


def build(cls: type[T], values: Mapping[str, Any], label: str) -> T:
    """Build the settings of a node from its parameters; a ValueError names the node too."""
    declared = declared_settings(cls)
    try:
        return build_settings(cls, {k: v for k, v in values.items() if k in declared})
    except ValueError as error:
        raise ValueError(f'{label}: {error}') from None
