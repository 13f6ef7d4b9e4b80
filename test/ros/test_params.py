# SPDX-License-Identifier: Apache-2.0
"""ROS parameters are what the settings class declares."""

from lowsnr_common.ros.parameters import declare
from lowsnr_common.settings.declare import declared_settings
from lowsnr_common.settings.flat_values import flat_values
from lowsnr_detect.detectors.sdt import SDT
from lowsnr_track.pda_mmpf import PdaMmpf
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter


def make_node(context, **overrides):
    """Return a node that was given parameter values."""
    values = [Parameter(name.replace('__', '.'), value=value) for name, value in overrides.items()]
    return Node('tested', context=context, parameter_overrides=values)


@pytest.mark.parametrize('cls', [SDT, PdaMmpf])
def test_defaults_of_node_and_class_agree(context, cls):
    node = make_node(context)
    built = declare(node, cls)
    assert built == cls()
    for name, value in flat_values(cls()).items():
        held = node.get_parameter(name).value
        assert (list(held) if isinstance(value, list) else held) == value
        assert node.describe_parameter(name).description == declared_settings(cls)[name].doc
        assert node.describe_parameter(name).read_only
    node.destroy_node()


def test_given_values_reach_the_instance_and_whole_numbers_do_for_numbers(context):
    node = make_node(context, max_iterations=8, sensor__snr_db=9, restart='unused')
    built = declare(node, SDT)
    assert (built.max_iterations, built.sensor.snr_db, built.restart) == (8, 9.0, 'unused')
    node.destroy_node()


@pytest.mark.parametrize(('name', 'value', 'said'), [
    ('max_iterations', 0, r'max_iterations = 0, .*\[1, 64\]'),
    ('max_iterations', 2.5, 'max_iterations = 2.5, '),
    ('sensor__noise_std', 'one', "sensor.noise_std = 'one', "),
    ('restart', 'some', "restart = 'some', .*'all', 'unused'"),
])
def test_bad_value_is_refused_by_name(context, name, value, said):
    node = make_node(context, **{name: value})
    with pytest.raises(ValueError, match=said):
        declare(node, SDT)
    node.destroy_node()


def test_value_set_on_a_running_node_is_refused(context):
    node = make_node(context)
    declare(node, SDT)
    answer = node.set_parameters([Parameter('max_iterations', value=3)])[0]
    assert not answer.successful
    assert node.get_parameter('max_iterations').value == SDT().max_iterations
    node.destroy_node()
