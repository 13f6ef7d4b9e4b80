# SPDX-License-Identifier: Apache-2.0
"""The table of who may write what names every input of every node, and no other."""

from functools import partial
from pathlib import Path
import re

from graph_runs import ROOT
from lowsnr_bringup.plan.graph import KINDS
from lowsnr_detect.node.detector_node import DetectorNode
from lowsnr_detect.tiles.merger_node import MergerNode
from lowsnr_detect.tiles.tile_node import TileNode
from lowsnr_eval.evaluator_node import EvaluatorNode
from lowsnr_eval.viewer_node import ViewerNode
from lowsnr_sensor.conditioner_node import ConditionerNode
from lowsnr_sensor.sensor_node import SensorNode
from lowsnr_track.tracker_node import TrackerNode
from rclpy.parameter import Parameter
from ros_nodes import node_domain
from ros_nodes import ros_context

ROW = re.compile(r'\| (\w+) \| `([\w/]+)` \| ([^|]+) \| ([^|]+) \| ([^|]+) \|')
SCENARIO = str(ROOT / 'config' / 'scenarios' / 'example1.yaml')
TILED = {'rows': 8, 'cols': 9, 'operating_point': 'nominal', 'tiles_down': 1, 'tiles_across': 2}
NODES = {
    'sensor': (SensorNode, {'scenario': SCENARIO, 'lockstep': True}),
    'conditioner': (ConditionerNode, {}),
    'tracker': (TrackerNode, {'rows': 8, 'cols': 9, 'conditioned': True}),
    'viewer': (ViewerNode, {}), 'detector': (partial(DetectorNode, 'cdt'), {
        'rows': 8, 'cols': 9, 'operating_point': 'nominal', 'conditioned': True}),
    'tile': (partial(TileNode, 'cdt', 2), TILED), 'merger': (partial(MergerNode, 'cdt'), TILED),
    'evaluator': (EvaluatorNode, {
        'detectors': ['cdt'], 'scenario': 's', 'conditioned': True})}
# Modules that subscribe: ManagedNode.listen, the first frames of a camera, the recorder.
SUBSCRIBING = {
    'lowsnr_common/ros/inputs.py', 'lowsnr_bringup/ros/camera.py',
    'lowsnr_bringup/ros/recorded_topic.py',
    'lowsnr_bringup/ros/heard/other_parts.py',  # only in a run on several hosts
    'lowsnr_bringup/cli/ros/subscription.py'}  # that of the ros2 command, which runs no graph


def table():
    """Return the topics of each node in the document."""
    found = {}
    for node, topic, *cells in ROW.findall((ROOT / 'docs' / 'trust.md').read_text()):
        assert all(cell.strip() for cell in cells)
        assert topic not in found.setdefault(node, [])
        found[node].append(topic)
    return found


def test_every_input_of_every_node_is_in_the_table(place):
    found = {}
    with ros_context(node_domain()) as context:
        for name, (make, values) in NODES.items():
            values = values | ({'results': str(place)} if name == 'evaluator' else {})
            node = make(context=context, parameter_overrides=[
                Parameter(key, value=value) for key, value in values.items()])
            assert node.trigger_configure().name == 'SUCCESS'
            found[name] = [item.topic_name.strip('/') for item in node.subscriptions]
            node.destroy_node()
    documented = table()
    assert documented.pop('player') == documented['sensor']  # both by Lockstep
    assert {name: sorted(topics) for name, topics in documented.items()} == {
        name: sorted(topics) for name, topics in found.items()}
    assert {*found, 'player', 'recorder'} == {*KINDS, 'detector', 'tile', 'merger'}


def test_no_other_module_subscribes():
    sources = {
        path.relative_to(ROOT / 'src').as_posix().partition('/')[2]: path.read_text()
        for path in Path(ROOT / 'src').glob('*/*/**/*.py')}
    assert {name for name, text in sources.items()
            if 'create_subscription(' in text} == SUBSCRIBING
    listening = {name for name, text in sources.items() if '.listen(' in text}
    assert listening == {
        'lowsnr_common/ros/frame_maps.py', 'lowsnr_common/ros/lockstep.py',
        'lowsnr_sensor/conditioner_node.py', 'lowsnr_detect/node/detector_node.py',
        'lowsnr_detect/tiles/tile_node.py', 'lowsnr_detect/tiles/merger_node.py',
        'lowsnr_track/tracker_node.py',
        'lowsnr_eval/viewer_node.py', 'lowsnr_eval/evaluator_node.py'}


def test_nothing_but_the_ros2_command_calls_services():
    sources = [path for folder in ('src', 'scripts') for path in (ROOT / folder).rglob('*.py')]
    assert len(sources) > 100
    assert [path.name for path in sources if 'create_client(' in path.read_text()] == [
        'client.py']
