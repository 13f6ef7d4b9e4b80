# SPDX-License-Identifier: Apache-2.0
"""ROS parameters of a node, declared from its settings class."""

from __future__ import annotations

from typing import Any
from typing import get_args
from typing import get_origin
from typing import TypeVar

from lowsnr_common.settings.declare import declared_settings
from lowsnr_common.settings.declare import Setting
from lowsnr_common.settings.flat_values import build_settings
from rcl_interfaces.msg import FloatingPointRange
from rcl_interfaces.msg import IntegerRange
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

T = TypeVar('T')

_TYPES = {
    bool: Parameter.Type.BOOL, int: Parameter.Type.INTEGER, float: Parameter.Type.DOUBLE,
    str: Parameter.Type.STRING,
}
_LISTS = {
    int: Parameter.Type.INTEGER_ARRAY, float: Parameter.Type.DOUBLE_ARRAY,
    str: Parameter.Type.STRING_ARRAY,
}


def declare(node: Node, cls: type[T], *, live: bool = False) -> T:
    """
    Declare every setting of a class as a parameter and build the instance.

    Parameters
    ----------
    node
        The node that gets the parameters.
    cls
        Settings class; ``group.value`` becomes the parameter of that name.
    live
        Whether the node takes live settings while it runs
        (:mod:`lowsnr_common.ros.settings_node`); all others are read-only.

    Raises
    ------
    ValueError
        If a value given to the node is of another type or out of bounds, by name.

    """
    declared = declared_settings(cls)
    values = {
        name: _declare_one(node, item, _descriptor(item, live)) for name, item in declared.items()}
    built = build_settings(cls, values)
    for name, item in declared.items():
        if item.live and live:
            # Only now: with a range, rclpy would reject a wrong value at the start, and not name
            # the parameter.
            node.set_descriptor(name, _with_range(_descriptor(item, live), item))
    return built


def _descriptor(item: Setting, live: bool) -> ParameterDescriptor:
    # Dynamic, so that a whole number is taken for a number.
    return ParameterDescriptor(
        description=item.doc, additional_constraints=item.allowed(), dynamic_typing=True,
        read_only=not (item.live and live))


def _with_range(descriptor: ParameterDescriptor, item: Setting) -> ParameterDescriptor:
    """Add the range that sliders show, where there is one; it has no open ends."""
    low = item.gt if item.ge is None else item.ge
    high = item.lt if item.le is None else item.le
    if low is not None and high is not None:
        if item.kind is float:
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(low), to_value=float(high))]
        else:
            descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high))]
    return descriptor


def _declare_one(node: Node, item: Setting, descriptor: ParameterDescriptor) -> Any:
    default = list(item.default) if isinstance(item.default, tuple) else item.default
    if isinstance(default, list):
        default = Parameter(item.name, _LISTS[get_args(item.kind)[0]], default).value
    value = node.declare_parameter(item.name, default, descriptor).value
    # An empty list in a file has no type: ROS reads it as no value.
    return list(value or ()) if get_origin(item.kind) is tuple else value
