# SPDX-License-Identifier: Apache-2.0
"""A node that was active before starts again, whichever of its readers have left meanwhile."""

from pathlib import Path

from lowsnr_common.ros import managed_node
from lowsnr_eval.evaluator_node import EvaluatorNode
from lowsnr_eval.scene import scene_writer
from lowsnr_sensor.conditioner_node import ConditionerNode
from lowsnr_sensor.sensor_node import SensorNode
import pytest
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import Image

DONE = TransitionCallbackReturn.SUCCESS
SCENARIO = Path(__file__).parents[2] / 'config' / 'scenarios' / 'example1.yaml'
MAPS = ['--ros-args', '-r', 'camera_info:=conditioned/camera_info']


@pytest.fixture
def made(context):
    """Return a function that makes a node with parameters."""
    nodes = []

    def make(kind, cli_args=None, **values):
        nodes.append(kind(context=context, cli_args=cli_args, parameter_overrides=[
            Parameter(name, value=value) for name, value in values.items()]))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()


@pytest.fixture
def others(context):
    """Return a node that reads what detector and tracker read, and sends frames."""
    node = Node('others', context=context)
    yield node
    node.destroy_node()


def sensor(make, **values):
    return make(SensorNode, scenario=str(SCENARIO), consumers=2, rate_hz=1000.0, **values)


def conditioner(make, **values):
    return make(ConditionerNode, consumers=1, **values)


@pytest.mark.parametrize(('start', 'frames'), [
    (sensor, 'image_raw'), (conditioner, 'conditioned/image_raw')])
def test_node_starts_again_after_the_evaluator_has_its_pictures(
        made, others, spin, tmp_path, monkeypatch, start, frames):
    monkeypatch.setattr(scene_writer, 'BUDGET', -1)  # full from the start
    evaluator = made(EvaluatorNode, MAPS, results=str(tmp_path), detectors=['cdt'],
                     conditioned=start is conditioner)
    assert evaluator.autostart()
    others.create_subscription(Image, frames, lambda _: None, 10)
    if start is conditioner:
        others.create_publisher(Image, 'image_raw', 10)
        for _ in ('detector', 'tracker'):
            others.create_subscription(
                CameraInfo, 'conditioned/camera_info', lambda _: None, 10)
    node = start(made)
    assert node.autostart()
    spin(lambda: node.count_subscribers(frames) == 1, evaluator)
    assert node.trigger_deactivate() == node.trigger_activate() == DONE
    assert node.trigger_deactivate() == node.trigger_cleanup() == DONE
    assert node.trigger_configure() == node.trigger_activate() == DONE
    assert start(made, lives=1).autostart()


def test_node_is_activated_again_after_all_have_left(made, others, spin):
    readers = [others.create_subscription(Image, 'conditioned/image_raw', lambda _: None, 10)
               for _ in range(2)]
    readers += [others.create_subscription(
        CameraInfo, 'conditioned/camera_info', lambda _: None, 10) for _ in range(3)]
    camera = others.create_publisher(Image, 'image_raw', 10)
    node = conditioner(made)
    assert node.autostart()
    for each in readers:
        others.destroy_subscription(each)
    others.destroy_publisher(camera)
    spin(lambda: not node.count_subscribers('conditioned/image_raw'), node)
    assert node.trigger_deactivate() == node.trigger_activate() == DONE


def test_sensor_that_lacks_its_readers_publishes_no_frame(made, spin, monkeypatch):
    monkeypatch.setattr(managed_node, '_PEERS_WITHIN_S', 0.0)
    node = sensor(made)
    assert not node.autostart()
    with pytest.raises(AssertionError):
        spin(lambda: node.counts['out'], node, within=10)
