# SPDX-License-Identifier: Apache-2.0
"""``ros2 param``: the parameters of nodes."""

from __future__ import annotations

import argparse
import re
import sys
from typing import Any

from lowsnr_bringup.cli.ros.client import add_graph_options
from lowsnr_bringup.cli.ros.client import Client
from lowsnr_bringup.cli.ros.client import graph_client
from rcl_interfaces.msg import Parameter
from rcl_interfaces.msg import ParameterDescriptor
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters
from rcl_interfaces.srv import GetParameters
from rcl_interfaces.srv import ListParameters
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import get_parameter_value
from rclpy.parameter import parameter_value_to_python
import yaml

# How each type is called in descriptions, and what stands before its value.
_TYPES = {
    ParameterType.PARAMETER_BOOL: ('boolean', 'Boolean value is:'),
    ParameterType.PARAMETER_INTEGER: ('integer', 'Integer value is:'),
    ParameterType.PARAMETER_DOUBLE: ('double', 'Double value is:'),
    ParameterType.PARAMETER_STRING: ('string', 'String value is:'),
    ParameterType.PARAMETER_BYTE_ARRAY: ('byte array', 'Byte values are:'),
    ParameterType.PARAMETER_BOOL_ARRAY: ('boolean array', 'Boolean values are:'),
    ParameterType.PARAMETER_INTEGER_ARRAY: ('integer array', 'Integer values are:'),
    ParameterType.PARAMETER_DOUBLE_ARRAY: ('double array', 'Double values are:'),
    ParameterType.PARAMETER_STRING_ARRAY: ('string array', 'String values are:'),
    ParameterType.PARAMETER_NOT_SET: ('not set', 'Parameter not set.'),
}


def add_verbs(verbs: Any) -> None:
    """Add the verbs of ``ros2 param``."""
    listing = verbs.add_parser('list', help='print the names of parameters', allow_abbrev=False)
    listing.add_argument('node_name', nargs='?', help='name of the node (default: all)')
    listing.add_argument('--filter', metavar='REGEX', help='only names that begin like this')
    listing.add_argument('--param-type', action='store_true', help='print the types too')
    get = verbs.add_parser('get', help='print a parameter', allow_abbrev=False)
    get.add_argument('node_name', help='name of the node')
    get.add_argument('parameter_name', help='name of the parameter')
    get.add_argument('--hide-type', action='store_true', help='print the value alone')
    change = verbs.add_parser('set', help='set a parameter', allow_abbrev=False)
    change.add_argument('node_name', help='name of the node')
    change.add_argument('parameter_name', help='name of the parameter')
    change.add_argument('value', help='its new value, as YAML')
    describe = verbs.add_parser('describe', help='describe parameters', allow_abbrev=False)
    describe.add_argument('node_name', help='name of the node')
    describe.add_argument('parameter_names', nargs='+', help='names of the parameters')
    dump = verbs.add_parser('dump', help='print all parameters as YAML', allow_abbrev=False)
    dump.add_argument('node_name', help='name of the node')
    for verb, run in ((listing, list_parameters), (get, print_value), (change, set_value),
                      (describe, print_descriptions), (dump, print_all)):
        add_graph_options(verb)
        verb.set_defaults(run=run)


def list_parameters(options: argparse.Namespace) -> None:
    """Print the names of the parameters of a node, or of all nodes."""
    try:
        wanted = re.compile(options.filter or '')
    except re.error as error:
        raise ValueError(f'--filter {options.filter!r}: {error}') from None
    with graph_client(options) as client:
        if options.node_name is not None:
            _print_names(client, client.find_node(options.node_name), wanted, options.param_type)
            return
        client.discover()
        for node in client.with_service(
                'list_parameters', 'rcl_interfaces/srv/ListParameters'):
            print(f'{node}:')
            _print_names(client, node, wanted, options.param_type)


def _print_names(client: Client, node: str, wanted: re.Pattern[str], with_types: bool) -> None:
    names = [name for name in _names(client, node) if wanted.match(name)]
    described = _descriptions(client, node, names) if with_types else []
    types = {each.name: f' (type: {_TYPES[each.type][0]})' for each in described}
    for name in names:
        print(f'  {name}{types.get(name, "")}')


def print_value(options: argparse.Namespace) -> None:
    """Print the value of a parameter, after its type."""
    with graph_client(options) as client:
        node = client.find_node(options.node_name)
        value, = _values(client, node, [options.parameter_name]) or [None]
    if value is None:
        raise ValueError('Parameter not set')
    kind = _TYPES[value.type][1]
    content = parameter_value_to_python(value)
    shown = [] if content is None else [content]
    print(*(shown or [None]) if options.hide_type else [kind, *shown])


def set_value(options: argparse.Namespace) -> None:
    """Set a parameter; ValueError with the node's reason where it rejects the value."""
    try:
        value = get_parameter_value(options.value)
    except yaml.YAMLError:
        raise ValueError(f'{options.value!r} is not YAML: put a text into quotes') from None
    parameter = Parameter(name=options.parameter_name, value=value)
    with graph_client(options) as client:
        node = client.find_node(options.node_name)
        result, = client.call(SetParameters, f'{node}/set_parameters', SetParameters.Request(
            parameters=[parameter])).results
    reason = f': {result.reason}' if result.reason else ''
    if not result.successful:
        raise ValueError(f'Setting parameter failed{reason}')
    print(f'Set parameter successful{reason}')


def print_descriptions(options: argparse.Namespace) -> None:
    """Print type, meaning and bounds of parameters."""
    with graph_client(options) as client:
        node = client.find_node(options.node_name)
        described = _descriptions(client, node, options.parameter_names)
    for each in described:
        print(_description(each))


def print_all(options: argparse.Namespace) -> None:
    """Print all parameters of a node as a parameter file."""
    with graph_client(options) as client:
        node = client.find_node(options.node_name)
        names = _names(client, node)
        values = _values(client, node, names)
    tree: dict[str, Any] = {}
    for name, value in zip(names, values, strict=True):
        *groups, last = name.split('.')
        branch = tree
        for group in groups:
            branch = branch.setdefault(group, {})
        branch[last] = parameter_value_to_python(value)
    yaml.safe_dump({node: {'ros__parameters': tree}}, sys.stdout, default_flow_style=False)


def _description(each: ParameterDescriptor) -> str:
    lines = [f'Parameter name: {each.name}', f'  Type: {_TYPES[each.type][0]}']
    if each.description:
        lines.append(f'  Description: {each.description}')
    lines.append('  Constraints:')
    if each.read_only:
        lines.append('    Read only: true')
    for bounds in [*each.floating_point_range, *each.integer_range]:
        lines += [f'    Min value: {bounds.from_value}', f'    Max value: {bounds.to_value}']
        if bounds.step:
            lines.append(f'    Step: {bounds.step}')
    if each.additional_constraints:
        lines.append(f'    Additional constraints: {each.additional_constraints}')
    return '\n'.join(lines)


def _names(client: Client, node: str) -> list[str]:
    """Return the names of all parameters of a node, sorted."""
    answer = client.call(ListParameters, f'{node}/list_parameters', ListParameters.Request())
    return sorted(answer.result.names)


def _values(client: Client, node: str, names: list[str]) -> list[Any]:
    return list(client.call(
        GetParameters, f'{node}/get_parameters', GetParameters.Request(names=names)).values)


def _descriptions(client: Client, node: str, names: list[str]) -> list[Any]:
    return list(client.call(
        DescribeParameters, f'{node}/describe_parameters',
        DescribeParameters.Request(names=names)).descriptors)
