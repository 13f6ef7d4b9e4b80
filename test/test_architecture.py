# SPDX-License-Identifier: Apache-2.0
"""The rules every module keeps; each rule is also shown to catch what it forbids."""

import ast
from collections import Counter
from collections.abc import Callable
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MAY_IMPORT: dict[str, set[str]] = {
    'lowsnr_common': set(),
    'lowsnr_sensor': {'lowsnr_common'},
    'lowsnr_detect': {'lowsnr_common'},
    'lowsnr_track': {'lowsnr_common'},
    'lowsnr_bringup': {'lowsnr_common', 'lowsnr_sensor', 'lowsnr_detect', 'lowsnr_track'},
    'lowsnr_eval': {
        'lowsnr_common', 'lowsnr_sensor', 'lowsnr_detect', 'lowsnr_track', 'lowsnr_bringup'},
    'lowsnr': {
        'lowsnr_common', 'lowsnr_sensor', 'lowsnr_detect', 'lowsnr_track', 'lowsnr_bringup'},
}
SEEDED = {'default_rng', 'Generator', 'SeedSequence'}
SPDX = '# SPDX-License-Identifier: Apache-2.0\n'
MODULE_LINES = 250
FUNCTION_LINES = 30
FOLDER_MODULES = 15


@dataclass(frozen=True)
class Module:
    """One source file: dotted name and text."""

    name: str
    source: str

    @cached_property
    def tree(self) -> ast.Module:
        return ast.parse(self.source)

    @property
    def package(self) -> str:
        return self.name.partition('.')[0]

    def functions(self) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
        for node in ast.walk(self.tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield node

    def imports(self) -> Iterator[str]:
        """Yield every imported module and name with its full dotted path."""
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                parent = '.'.join(self.name.split('.')[:-node.level]) if node.level else ''
                base = '.'.join(part for part in (parent, node.module) if part)
                yield from (f'{base}.{alias.name}' for alias in node.names)


def is_edge(name: str) -> bool:
    """Tell whether a module may know ROS: those under ``ros/`` and the nodes."""
    parts = name.split('.')
    return 'ros' in parts[1:] or any(part.endswith('_node') for part in parts)


def is_ros(name: str) -> bool:
    top = name.partition('.')[0]
    return top in {'rclpy', 'rpyutils'} or top.endswith(('_msgs', '_interfaces'))


def cores_without_ros(module: Module) -> Iterator[str]:
    for name in module.imports():
        ours = name.partition('.')[0] in MAY_IMPORT
        if not is_edge(module.name) and (is_ros(name) or (ours and is_edge(name))):
            yield f'imports {name}'


def one_direction(module: Module) -> Iterator[str]:
    for name in module.imports():
        package = name.partition('.')[0]
        if package in MAY_IMPORT and package not in {module.package, *MAY_IMPORT[module.package]}:
            yield f'imports {name}'


def privacy(module: Module) -> Iterator[str]:
    for name in module.imports():
        package, *parts = name.split('.')
        private = any(part.startswith('_') and not part.endswith('__') for part in parts)
        if package != module.package and private:
            yield f'imports {name}'


def handed_in_randomness(module: Module) -> Iterator[str]:
    for name in module.imports():
        if name == 'random' or name.startswith('random.') or name == 'numpy.random':
            yield f'imports {name}'
        if name.startswith('numpy.random.') and name.split('.')[2] not in SEEDED:
            yield f'imports {name}'
    for node in ast.walk(module.tree):
        path = ast.unparse(node) if isinstance(node, ast.Attribute) else ''
        parent, _, name = path.rpartition('.')
        if parent in {'np.random', 'numpy.random'} and name not in SEEDED:
            yield f'line {node.lineno}: uses {path}'
        if isinstance(node, ast.Call) and ast.unparse(node).endswith('default_rng()'):
            yield f'line {node.lineno}: default_rng without a seed'


def named_exceptions(module: Module) -> Iterator[str]:
    for node in ast.walk(module.tree):
        if isinstance(node, ast.ExceptHandler):
            caught = node.type.elts if isinstance(node.type, ast.Tuple) else [node.type]
            names = {ast.unparse(item) if item else 'everything' for item in caught}
            for name in names & {'everything', 'Exception', 'BaseException'}:
                yield f'line {node.lineno}: catches {name}'


def size(module: Module) -> Iterator[str]:
    lines = len(module.source.splitlines()) - module.source.count(SPDX)  # beside the code
    if lines > MODULE_LINES:
        yield f'{lines} lines, at most {MODULE_LINES}'
    for node in module.functions():
        body = node.body[1:] if ast.get_docstring(node) is not None else node.body
        lines = body[-1].end_lineno - body[0].lineno + 1 if body else 0
        if lines > FUNCTION_LINES:
            yield f'line {node.lineno}: {node.name} has {lines} lines, at most {FUNCTION_LINES}'


def docstrings(module: Module) -> Iterator[str]:
    if ast.get_docstring(module.tree) is None:
        yield 'the module has no docstring'
    yield from undocumented(module.tree)


def undocumented(parent: ast.Module | ast.ClassDef) -> Iterator[str]:
    for node in parent.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            public = not node.name.startswith('_')
            if public and ast.get_docstring(node) is None:
                yield f'line {node.lineno}: {node.name} has no docstring'
            if public and isinstance(node, ast.ClassDef):
                yield from undocumented(node)


Rule = Callable[[Module], Iterator[str]]
PACKAGE_RULES: list[Rule] = [cores_without_ros, one_direction, docstrings]
RULES: list[Rule] = [privacy, handed_in_randomness, named_exceptions, size]


def package_modules() -> Iterator[tuple[Path, Module]]:
    for package in MAY_IMPORT:
        folder = ROOT / 'src' / package
        for path in sorted((folder / package).rglob('*.py')):
            name = '.'.join(path.relative_to(folder).with_suffix('').parts)
            yield path, Module(name, path.read_text(encoding='utf-8'))


def other_modules() -> Iterator[tuple[Path, Module]]:
    for folder in ('scripts', 'test'):
        for path in sorted((ROOT / folder).rglob('*.py')):
            yield path, Module(path.stem, path.read_text(encoding='utf-8'))


def violations(rule: Rule) -> list[str]:
    modules = list(package_modules())
    if rule in RULES:
        modules += other_modules()
    return [f'{path.relative_to(ROOT)}: {found}' for path, mod in modules for found in rule(mod)]


@pytest.mark.parametrize('rule', PACKAGE_RULES + RULES, ids=lambda rule: rule.__name__)
def test_every_module_keeps(rule):
    found = violations(rule)
    assert not found, '\n'.join(found)


def test_modules_of_every_package_are_looked_at():
    assert {module.package for _, module in package_modules()} == set(MAY_IMPORT)


LONG = 'def f():\n' + '    x = 1\n' * (FUNCTION_LINES + 1)
CORE = 'lowsnr_detect.parts.wald_bounds'
BAD = [
    (cores_without_ros, CORE, 'import rclpy.node'),
    (cores_without_ros, CORE, 'def f():\n    from nav_msgs.msg import Odometry'),
    (cores_without_ros, CORE, 'from lowsnr_sensor.ros import params'),
    (cores_without_ros, CORE, 'from ..node.detector_node import main'),
    (one_direction, 'lowsnr_sensor.grid', 'from lowsnr_detect import registry'),
    (one_direction, 'lowsnr_detect.parts.registry', 'import lowsnr_track.mmpf'),
    (one_direction, 'lowsnr_track.mmpf', 'from lowsnr_detect.parts.registry import register'),
    (one_direction, 'lowsnr_track.mmpf', 'import lowsnr_eval'),
    (one_direction, 'lowsnr_bringup.plan.graph', 'from lowsnr_eval.scoring import metrics'),
    (one_direction, 'lowsnr_common.core.motion', 'import lowsnr_sensor.scenario'),
    (one_direction, 'lowsnr_eval.scoring.metrics', 'import lowsnr'),
    (privacy, CORE, 'from lowsnr_common.settings.declare import _convert'),
    (privacy, CORE, 'import numpy._core'),
    (handed_in_randomness, CORE, 'import random'),
    (handed_in_randomness, CORE, 'from numpy.random import normal'),
    (handed_in_randomness, CORE, 'np.random.seed(1)'),
    (handed_in_randomness, CORE, 'rng = np.random.default_rng()'),
    (named_exceptions, CORE, 'try:\n    f()\nexcept:\n    pass'),
    (named_exceptions, CORE, 'try:\n    f()\nexcept (ValueError, Exception):\n    pass'),
    (size, CORE, LONG),
    (size, CORE, '\n' * (MODULE_LINES + 1)),
    (docstrings, CORE, '"""Doc."""\ndef f(): pass'),
    (docstrings, CORE, '"""Doc."""\nclass C:\n    """Doc."""\n    def m(self): pass'),
    (docstrings, CORE, 'x = 1'),
]
GOOD = [
    (cores_without_ros, 'lowsnr_common.ros.parameters', 'import rclpy'),
    (cores_without_ros, 'lowsnr_detect.node.detector_node', 'import vision_msgs.msg'),
    (one_direction, 'lowsnr_eval.scoring.metrics', 'from lowsnr_track import mmpf'),
    (privacy, CORE, 'from __future__ import annotations\nfrom ._tables import _steps'),
    (handed_in_randomness, CORE, 'def f(seed):\n    return np.random.default_rng(seed)'),
    (handed_in_randomness, CORE, 'np.random.SeedSequence(7).spawn(2)'),
    (named_exceptions, CORE, 'try:\n    f()\nexcept ValueError:\n    pass'),
    (size, CORE, 'def f():\n    """' + 'Doc.\n' * 60 + '"""\n    return 1'),
    (docstrings, CORE, '"""Doc."""\ndef _f(): pass\nclass C:\n    """Doc."""'),
]


@pytest.mark.parametrize(('rule', 'name', 'source'), BAD)
def test_rule_catches(rule, name, source):
    assert list(rule(Module(name, source)))


@pytest.mark.parametrize(('rule', 'name', 'source'), GOOD)
def test_rule_allows(rule, name, source):
    assert not list(rule(Module(name, source)))


def test_no_folder_has_more_than_fifteen_modules():
    modules = [path for path in (ROOT / 'src').rglob('*.py') if path.name != '__init__.py']
    counts = Counter(path.parent for path in modules)
    assert not [str(folder) for folder, count in counts.items() if count > FOLDER_MODULES]
