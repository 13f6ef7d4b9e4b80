# SPDX-License-Identifier: Apache-2.0
"""The parameters that follow from which nodes a run has, and how a detector is divided."""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import asdict

from lowsnr_bringup.plan.graph import build
from lowsnr_bringup.plan.graph import EVERY_NODE
from lowsnr_bringup.plan.graph import Layer
from lowsnr_bringup.plan.graph import Node
from lowsnr_bringup.plan.graph import node_of
from lowsnr_bringup.plan.graph import Values
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_common.settings.node_settings import TileSettings
from lowsnr_detect.parts.detector import Detector
from lowsnr_detect.tiles.tile import divisible
from lowsnr_detect.tiles.tile import tiles_of


def wiring(nodes: Sequence[Node], detectors: Sequence[str], scenario: str) -> Layer:
    """
    Return the parameters that follow from which nodes a run has.

    ``consumers`` is the number of subscribers that a node waits for before it publishes.
    """
    names = {node.name for node in nodes}
    viewers, chains = int('viewer' in names), len(detectors)  # a viewer in each chain
    tiles = [node.name for node in nodes if node.tile]
    # Detectors or their tiles, or the conditioner in their place; evaluator and viewers.
    readers = 1 if 'conditioner' in names else len(tiles) or chains
    frame_readers = readers + 1 + chains * viewers
    consumers = {
        'sensor': frame_readers, 'player': frame_readers, 'conditioner': chains,
        **{node_of(name): 2 + viewers for name in detectors},  # tracker, evaluator, viewer
        **dict.fromkeys(tiles, 1),  # the merger
        'tracker': 1 + viewers,  # evaluator, viewer
        'viewer': 1,  # so that it waits for its publishers
        'evaluator': sum(node.source for node in nodes)}  # sensor or player
    layer: dict[str, Values] = {name: {'consumers': count} for name, count in consumers.items()}
    layer[EVERY_NODE] = {
        'autostart': False, 'observers': int('recorder' in names),
        'conditioned': 'conditioner' in names}
    layer['evaluator'] |= {
        'scenario': scenario, 'detectors': list(detectors), 'namespaces': len(detectors) > 1}
    for node in nodes:
        if node.live:
            layer.setdefault(node.name, {})['live'] = True
    return layer


def divide(
    nodes: Sequence[Node], parameters: dict[str, Values], detectors: Mapping[str, Detector],
    tiles: tuple[int, int],
) -> None:
    """
    Give the nodes of divided detectors their tiles, down and across.

    Raises
    ------
    ValueError
        One line, if a detector or its frames cannot be divided.

    """
    # The evaluator counts a frame as unanswered after twice as long.
    within_s = parameters['/evaluator'].get(
        'answer_within_s', RunSettings.answer_within_s) / 2.0
    tiling = TileSettings(tiles_down=tiles[0], tiles_across=tiles[1], tile_within_s=within_s)
    for node in nodes:
        if node.merges:
            _check(node.label, detectors[node.path], parameters[node.path], tiling)
        if node.merges or node.tile:
            parameters[node.path] |= asdict(tiling)


def _check(label: str, detector: Detector, values: Values, tiling: TileSettings) -> None:
    """Raise ValueError where a detector or its frames cannot be divided."""
    if values.get('conditioned'):
        raise ValueError(
            f'{label}: frames that pass a conditioner cannot be divided into tiles; leave out '
            '--tiles, or set --condition off')
    try:
        local = divisible(detector, build(DetectionSettings, values, label))
        tiles_of(local, (values.get('rows', 0), values.get('cols', 0)), tiling)
    except ValueError as error:
        raise ValueError(f'{label}: {error}') from None
