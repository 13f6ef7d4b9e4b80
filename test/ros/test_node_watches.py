# SPDX-License-Identifier: Apache-2.0
"""A node of which several things are watched has each of them printed."""

from diagnostic_msgs.msg import DiagnosticStatus
from lowsnr_bringup.plan.graph import run_nodes
from lowsnr_bringup.ros.node_watch import NodeWatches
from lowsnr_common.ros.diagnostics import Fault
from lowsnr_common.ros.diagnostics import Health
from lowsnr_common.ros.inputs import SILENT
from lowsnr_common.ros.managed_node import BROKEN
from lowsnr_detect.tiles.tile_join import WITHOUT_TILE
import pytest


def status(name, *faults):
    """Return the status of a node with faults."""
    return Health().status(name, list(faults), {'process': '7', WITHOUT_TILE: '1'})


@pytest.mark.parametrize('camera', ['/camera', ''])
def test_evaluator_alone_has_the_faults_of_a_camera_and_of_results_printed(capsys, camera):
    nodes = [node for node in run_nodes(['sdt'], camera=camera) if node.name == 'evaluator']
    watches = NodeWatches(nodes)
    statuses = {'/evaluator': status('/evaluator', Fault(
        'image_raw', SILENT, 'no message for 9 s'), Fault('evaluator', BROKEN, 'disk full'))}
    statuses['/other'] = DiagnosticStatus()
    watches.update(statuses)
    watches.update(statuses)
    printed = capsys.readouterr().err
    assert printed.count('no message for 9 s') == bool(camera)
    assert printed.count('disk full') == 1
    assert 'disk full' in watches.results.fault
    assert [*statuses] == ['/other']  # of what is watched, each is taken once


def test_frames_without_a_tile_are_counted_at_the_end(capsys):
    nodes = run_nodes(['cdt', 'sdt'], tiles=2)
    watches = NodeWatches(nodes)
    watches.update({node.path: status(node.path) for node in nodes if node.merges})
    watches.sum_up()
    printed = capsys.readouterr().err
    for label in ('cdt.cdt_detector', 'sdt.sdt_detector'):
        assert f'{label}: 1 frame was answered without a tile' in printed
