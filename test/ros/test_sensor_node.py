# SPDX-License-Identifier: Apache-2.0
"""When the sensor node publishes a frame, and when it says that it has."""

from contextlib import nullcontext
import sys

from graph_runs import ROOT
from lowsnr_common.ros.bringup_line import DATA_TIME
from lowsnr_sensor.sensor_node import SensorNode
import pytest
from rclpy.parameter import Parameter

SCENARIO = ROOT / 'config' / 'scenarios' / 'example3.yaml'


@pytest.mark.parametrize('interrupted', [False, True])
def test_source_tells_of_a_frame_once_it_has_published_it(context, monkeypatch, interrupted):
    node = SensorNode(context=context, parameter_overrides=[
        Parameter('scenario', value=str(SCENARIO)), Parameter('lockstep', value=True)])
    node.autostart()
    order = []

    def publish(_):
        order.append('image')
        if interrupted:  # by a signal: the image may have reached a reader
            sys.exit('interrupted')

    monkeypatch.setattr(node.bringup, 'tell', lambda subject, _: order.append(subject))
    monkeypatch.setattr(node._image, 'publish', publish)
    with pytest.raises(SystemExit) if interrupted else nullcontext():
        node._publish_next()
    assert order == ['image', DATA_TIME]
    node.destroy_node()


@pytest.mark.parametrize('lockstep', [False, True])
def test_first_frame_does_not_wait_for_the_period_of_the_others(context, spin, lockstep):
    node = SensorNode(context=context, parameter_overrides=[
        Parameter('scenario', value=str(SCENARIO)), Parameter('rate_hz', value=1e-6),
        Parameter('lockstep', value=lockstep)])
    node.autostart()
    spin(lambda: node.counts['out'] == 1, node)
    assert [timer.timer_period_ns for timer in node.timers].count(10**15) == (not lockstep)
    node.destroy_node()
