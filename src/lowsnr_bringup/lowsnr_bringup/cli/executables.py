# SPDX-License-Identifier: Apache-2.0
"""Where ``ros2 run`` finds the executables of a package, and how it starts them."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from importlib.util import find_spec
import os
from pathlib import Path
import sys
from typing import NoReturn

from lowsnr_bringup.cli import commands
from lowsnr_bringup.plan import graph
from lowsnr_common.settings.text import did_you_mean
from lowsnr_detect.parts.registry import DETECTORS

_INDEX = Path('share', 'ament_index', 'resource_index', 'packages')
_DETECTOR_NODE = graph.node_kind('sdt_detector').module


def own_executables() -> dict[tuple[str, str], tuple[str, str]]:
    """Return module and function of every node and command, by package and executable."""
    modules = [kind.module for kind in graph.KINDS.values()]
    found = {
        (module.partition('.')[0], module.rpartition('.')[2]): (module, 'main')
        for module in modules}
    package = _DETECTOR_NODE.partition('.')[0]
    return found | {
        (package, f'{name}_node'): (_DETECTOR_NODE, name) for name in DETECTORS} | {
        (commands.PACKAGE, name): (commands.__name__, name) for name in commands.COMMANDS}


def installed_executable(package: str, name: str) -> Path | None:
    """
    Return the executable of an installed package, None if no installed package is of this name.

    Raises
    ------
    ValueError
        If the package has no such executable; names the folder that was searched.

    """
    for prefix in map(Path, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)):
        if (prefix / _INDEX / package).is_file():
            path = prefix / 'lib' / package / name
            if os.access(path, os.X_OK) and path.is_file():
                return path
            raise ValueError(f'No executable found: {path.parent} has no {name}')
    return None


def _installed_first(environ: Mapping[str, str]) -> dict[str, str]:
    """Return the environment in which installed packages come before those of a checkout."""
    paths = environ.get('PYTHONPATH', '').split(os.pathsep)
    paths.sort(key=lambda path: Path(path, 'package.xml').is_file())  # and else as they are
    return {**environ, 'PYTHONPATH': os.pathsep.join(paths)}


def run_executable(package: str, name: str, arguments: list[str]) -> NoReturn:
    """
    Become the executable of a package: an installed one, or a node or command of this project.

    Raises
    ------
    ValueError
        If there is no such package or executable; names the nearest one.

    """
    own = own_executables()
    path = installed_executable(package, name)
    if path is not None:
        os.execve(path, [str(path), *arguments], _installed_first(os.environ))
    if (package, name) not in own:
        names = [each for known, each in own if known == package]
        if not names:
            raise ValueError(f"Package '{package}' not found"
                             + did_you_mean(package, {known for known, _ in own}))
        raise ValueError(f'No executable found: {package} has no {name}'
                         + did_you_mean(name, names))
    module, function = own[package, name]
    sys.argv = [str(find_spec(module).origin), *arguments]  # type: ignore[union-attr]
    getattr(import_module(module), function)()
    sys.exit(0)
