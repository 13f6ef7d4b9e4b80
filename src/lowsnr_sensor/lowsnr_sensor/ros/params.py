"""ROS parameters of a node, declared from its settings class."""

from __future__ import annotations

from typing import Any
from typing import get_args
from typing import get_origin
from typing import TypeVar

from lowsnr_sensor.config import build_settings
from lowsnr_sensor.config import declared_settings
from lowsnr_sensor.config import Setting
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


def declare(node: Node, cls: type[T]) -> T:
    """
    Declare every setting of a class as a read-only parameter and build the instance.

    Parameters
    ----------
    node
        The node that gets the parameters.
    cls
        Settings class; ``group.value`` becomes the parameter of that name.

    Raises
    ------
    ValueError
        If a value given to the node is of another type or out of bounds, by name.

    """
    values = {name: _declare_one(node, item) for name, item in declared_settings(cls).items()}
    return build_settings(cls, values)


def _declare_one(node: Node, item: Setting) -> Any:
    descriptor = ParameterDescriptor(
        description=item.doc, additional_constraints=item.allowed(), read_only=True,
        dynamic_typing=True)
    default = list(item.default) if isinstance(item.default, tuple) else item.default
    if isinstance(default, list):
        default = Parameter(item.name, _LISTS[get_args(item.kind)[0]], default).value
    value = node.declare_parameter(item.name, default, descriptor).value
    return list(value) if get_origin(item.kind) is tuple else value
