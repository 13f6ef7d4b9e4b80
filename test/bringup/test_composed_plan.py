# SPDX-License-Identifier: Apache-2.0
"""The plan of a run whose conditioner, detectors and trackers share a process."""

from pathlib import Path

from lowsnr_bringup.chain_node import split
from lowsnr_bringup.plan.node_command import by_process
from lowsnr_bringup.plan.node_command import node_command
from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_bringup.plan.run_plan import plan_run

CONFIG = Path(__file__).resolve().parents[2] / 'config'


def plan(**options):
    return plan_run(RunOptions(**{'detectors': ['sdt'], 'scenario': 'example3'} | options), CONFIG)


def test_composed_chains_share_one_process_and_nothing_else_changes(tmp_path):
    options = {'detectors': ['cdt', 'sdt'], 'view': True, 'record': tmp_path / 'bag'}
    apart, composed = plan(**options), plan(**options, composed=True)
    assert [node.path for node in composed.nodes] == [node.path for node in apart.nodes]
    assert composed.parameters == apart.parameters
    shared = [node.path for node in composed.nodes if node.process]
    assert shared == ['/cdt/tracker', '/cdt/cdt_detector', '/sdt/tracker', '/sdt/sdt_detector']
    assert {node.enclave for node in composed.nodes if node.process} == {'/chain'}
    processes = by_process(composed.nodes)
    assert [node.path for nodes in processes if len(nodes) > 1 for node in nodes] == shared
    assert sum(map(len, processes)) == len(composed.nodes)


def test_command_of_a_composed_process_has_the_arguments_of_each_node():
    detector, tracker = (
        next(node for node in plan(composed=True).nodes if node.name == name)
        for name in ('sdt_detector', 'tracker'))
    module, words = node_command(
        {tracker: {'lives': 2}, detector: {}}, Path('parameters.yaml'))
    assert module == 'lowsnr_bringup.chain_node'
    of_process, *nodes = split(words)
    assert of_process[:3] == ['--ros-args', '--enclave', '/chain']
    given = ['--ros-args', '--params-file', 'parameters.yaml']
    assert nodes == [['lowsnr_track.tracker_node', *given, '-p', 'lives:=2'],
                     ['lowsnr_detect.node.detector_node', 'sdt', *given]]
