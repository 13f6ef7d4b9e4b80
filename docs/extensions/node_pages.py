# SPDX-License-Identifier: Apache-2.0
"""
Write a page for every node: its parameters, and its topics with their quality of service.

The parameters are those that the settings classes declare.  The topics are read from the node
itself, which is made and configured in this process.
"""

from collections.abc import Iterable
from collections.abc import Iterator
from importlib import import_module
import inspect
from pathlib import Path
import re
import tempfile
from typing import Any
from typing import cast
from typing import get_origin

from lowsnr_bringup.formats.image_files import open_frames
from lowsnr_bringup.plan.graph import known_nodes
from lowsnr_bringup.plan.graph import node_kind
from lowsnr_bringup.plan.graph import settings_classes
from lowsnr_bringup.ros.film_bag import write_film
from lowsnr_common.ros.managed_node import ManagedNode
from lowsnr_common.settings.declare import declared_settings
from lowsnr_common.settings.declare import Setting
from lowsnr_common.settings.node_settings import NodeSettings
from lowsnr_detect.parts.registry import detector_class
import numpy as np
import rclpy
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from sphinx.application import Sphinx

FOLDER = 'generated/nodes'
SCENARIO = Path(__file__).resolve().parents[2] / 'config' / 'scenarios' / 'example4.yaml'
OF_ROS = ('/rosout', '/parameter_events', '/transition_event')
UNIT = re.compile(r' ?\[([^\]\d][^\]]*)\]')
ORDER = ('sensor', 'player', 'conditioner', 'tracker', 'evaluator', 'viewer', 'recorder')


def write_pages(app: Sphinx) -> None:
    """Write the pages into the sources of the manual."""
    folder = Path(app.srcdir, FOLDER)
    folder.mkdir(parents=True, exist_ok=True)
    names = [*ORDER, *sorted({*known_nodes()} - {*ORDER})]
    remove_others(folder, {*names, 'every_node', 'index'})
    topics = topics_of([*ORDER, 'cdt_detector'])  # a detector decides what, not where
    write(folder / 'every_node.rst', [
        *title('Parameters of every node'), *parameters([NodeSettings], live=True)])
    for name in names:
        write(folder / f'{name}.rst', page(name, topics.get(name) or topics['cdt_detector']))
    write(folder / 'index.rst', [
        *title('Nodes'),
        'One page a node: what it does, its topics with their quality of service, and its '
        'parameters. Parameters are set in the files of ``config``, by ``--set '
        'NODE.PARAMETER=VALUE`` of ``bringup.py``, where ``sdt`` stands for ``sdt_detector``, and '
        'those that are live by ``ros2 param set`` while the node runs.', '',
        '.. toctree::', '   :maxdepth: 1', '', '   every_node', *(f'   {name}' for name in names)])


def remove_others(folder: Path, names: set[str]) -> None:
    """Remove the pages of nodes that are gone, which no table of contents would name."""
    for path in folder.glob('*.rst'):
        if path.stem not in names:
            path.unlink()


def write(path: Path, lines: Iterable[str]) -> None:
    """Write a page, unless it is the same as before."""
    text = '\n'.join(lines) + '\n'
    if not path.exists() or path.read_text(encoding='utf-8') != text:
        path.write_text(text, encoding='utf-8')


def page(name: str, topics: list[tuple[str, ...]]) -> list[str]:
    """Return the page of a node."""
    kind, described = node_kind(name), cast(type, class_of(name))
    package = kind.module.partition('.')[0]
    executable = kind.module.rpartition('.')[2]
    lines = [*title(name)]
    if name.endswith('_detector'):
        detector = name.removesuffix('_detector')
        described, executable = detector_class(detector), f'{detector}_node'
        lines += [module_doc(described), '']
    return [
        *lines, inspect.getdoc(class_of(name)) or '', '',
        f'Class: :class:`~{described.__module__}.{described.__qualname__}`. '
        f'Started by itself: ``ros2 run {package} {executable}``.', '',
        *title('Topics', '-'), *table(('', 'topic', 'type', 'QoS'), topics), '',
        *title('Parameters', '-'),
        'Besides :doc:`those of every node <every_node>`:', '',
        *parameters(settings_classes(name)[1:], live=is_live(name))]


def module_doc(cls: type) -> str:
    """Return the first line about a detector, that of its module."""
    return (inspect.getdoc(inspect.getmodule(cls)) or '').partition('\n')[0]


def title(text: str, line: str = '=') -> list[str]:
    """Return the lines of a title."""
    return [text, line * len(text), '']


def class_of(name: str) -> type[ManagedNode]:
    """Return the class of a node."""
    module = import_module(node_kind(name).module)
    return next(
        item for item in vars(module).values() if isinstance(item, type)
        and issubclass(item, ManagedNode) and item.__module__ == module.__name__)


def is_live(name: str) -> bool:
    """Return whether a node takes live settings while it runs."""
    return name == 'tracker' or name.endswith('_detector')


def parameters(classes: Iterable[type], live: bool) -> list[str]:
    """Return the table of the parameters that settings classes declare."""
    items = [item for cls in classes for item in declared_settings(cls).values()]
    return table(
        ('name', 'type', 'default', 'allowed', 'unit', 'live', 'meaning'),
        [row(item, live) for item in items])


def row(item: Setting, live: bool) -> tuple[str, ...]:
    """Return the cells of one parameter."""
    unit = UNIT.search(item.doc)
    meaning = UNIT.sub('', item.doc) if unit else item.doc
    default = list(item.default) if isinstance(item.default, tuple) else item.default
    shown = str(default).lower() if isinstance(default, bool) else repr(default)
    return (
        f'``{item.name}``', type_name(item.kind), f'``{shown}``', bounds(item),
        unit[1] if unit else '', 'yes' if item.live and live else '', plain(meaning))


def type_name(kind: Any) -> str:
    """Return the ROS name of the type of a parameter."""
    names = {bool: 'bool', int: 'integer', float: 'double', str: 'string'}
    if get_origin(kind) is tuple:
        return f'{names[kind.__args__[0]]} array'
    return names[kind]


def bounds(item: Setting) -> str:
    """Return the values that a parameter may have."""
    if item.choices is not None:
        return ', '.join(f'``{choice}``' for choice in item.choices)
    return plain(item.allowed().rpartition(' in ')[2]) if ' in ' in item.allowed() else ''


def plain(text: str) -> str:
    """Return a text without characters that reStructuredText would act on."""
    return re.sub(r'([\\*`|_])', r'\\\1', text)


def table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> list[str]:
    """Return the lines of a table."""
    lines = ['.. list-table::', '   :header-rows: 1', '   :widths: auto', '   :class: facts']
    for cells in (head, *rows):
        lines += [''] if cells is head else []
        lines += [f'   {"*" if n == 0 else " "} - {cell}' for n, cell in enumerate(cells)]
    return [*lines, '']


def topics_of(names: Iterable[str]) -> dict[str, list[tuple[str, ...]]]:
    """Return the topics of each node: direction, name, type and quality of service."""
    context = rclpy.Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    try:
        with tempfile.TemporaryDirectory() as place:
            return {name: sorted(connections(name, Path(place), context)) for name in names}
    finally:
        context.try_shutdown()


def connections(name: str, place: Path, context: rclpy.Context) -> Iterator[tuple[str, ...]]:
    """Yield the topics of a node."""
    if name == 'recorder':
        yield 'subscribes', 'every topic of the run', 'any', 'that of the publishers'
    cls = class_of(name)
    given = {'context': context, 'parameter_overrides': [
        Parameter(key, value=value) for key, value in example(name, place).items()]}
    node = cls(name.removesuffix('_detector'), **given) if name.endswith('_detector') else cls(
        **given)
    try:
        if node.trigger_configure().name != 'SUCCESS':
            raise RuntimeError(f'{name} cannot be configured')
        followers = [each.subscription for each in node.inputs if each.follows]
        for direction, ends in (
                ('publishes', node.publishers), ('subscribes', node.subscriptions)):
            for end in ends:
                if not end.topic_name.endswith(OF_ROS):
                    yield (direction, f'``{end.topic_name.lstrip("/")}``',
                           kind_name(end.msg_type), qos(end, end in followers))
    finally:
        node.destroy_node()


def kind_name(kind: type) -> str:
    """Return the name of a type of messages."""
    return f'``{kind.__module__.partition(".")[0]}/{kind.__name__}``'


def qos(end: Any, follows: bool) -> str:
    """Return the quality of service of a publisher or subscription."""
    profile = end.qos_profile
    name = 'as the publisher' if follows else profile.reliability.name.lower()
    return f'{name}, the last {profile.depth} kept'


def example(name: str, place: Path) -> dict[str, Any]:
    """Return the parameters with which a node makes all its connections."""
    conditioned = {'conditioned': True, 'rows': 20, 'cols': 24}
    detector = {**conditioned, 'operating_point': 'nominal', 'statistic_map': True}
    if name == 'player':
        bag = place / 'bag'
        np.save(place / 'frames.npy', np.random.default_rng(0).normal(size=(3, 8, 9)))
        write_film(open_frames(place / 'frames.npy'), bag, period_s=1.0)
        return {'bag': str(bag), 'lockstep': True}
    others: dict[str, dict[str, Any]] = {
        'sensor': {'scenario': str(SCENARIO), 'lockstep': True},
        'tracker': conditioned,
        'evaluator': {'detectors': ['sdt'], 'scenario': 'example4', 'conditioned': True,
                      'results': str(place / 'results'), 'statistic_maps': ['sdt']},
        'recorder': {'bag': str(place / 'recorded')},
        'viewer': {'page': False, 'statistic_map': True},  # or it would open a browser
    }
    return others.get(name, detector if is_live(name) else {})


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages before Sphinx looks for its sources."""
    app.connect('builder-inited', write_pages)
    return {'parallel_read_safe': True, 'parallel_write_safe': True}
