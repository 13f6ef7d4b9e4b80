# SPDX-License-Identifier: Apache-2.0
"""
Find a Python that has ROS 2 Jazzy, or make one: every script does this first.

1. The running interpreter has ROS 2 and all packages from PyPI: it is used as it is.
2. It has ROS 2, but lacks packages from PyPI: they are installed in ``.venv``, which also sees
   those of the system.  The system itself is not changed.
3. It has no ROS 2: the packages that requirements/ locks are installed in ``.venv``, and
   vision_msgs is built there.

What ``colcon build`` installed is used as it is too: rosdep installs what its packages depend on,
but for some packages that it has no keys of, and those are named.

In cases 2 and 3 the script restarts itself with the interpreter of ``.venv``, which `_venv`
makes unless it is complete.

A Python that is too old for the project is left as soon as it imports this module, because it
could not compile the rest of a script.  Everything up to that import uses old syntax.
"""

from collections.abc import Iterable
import contextlib
from importlib.machinery import EXTENSION_SUFFIXES
import importlib.util
import os
from pathlib import Path
import re
import subprocess
import sys
from typing import NoReturn

import _steps
import _venv

INSTALLED = not (_venv.ROOT / 'src').is_dir()  # by colcon, into the share of lowsnr_bringup
SOURCES = [str(path) for path in sorted((_venv.ROOT / 'src').glob('lowsnr*'))]
MODULES = {'opencv-python-headless': 'cv2'}  # of packages that are not named like theirs
EXTRAS = ('bags', 'files', 'study')  # of requirements/, which some commands need
# The part of an extra that a command needs which uses no more of it.
PARTS = {'images': ('files', 'opencv-python-headless')}
OLDEST = (3, 11)
WITH_WHEELS = ('3.12', '3.11', '3.13')  # for which PyPI has ROS 2, the preferred one first
INDEX = os.path.join(sys.prefix, 'share', 'ament_index')  # of the ROS wheels
OPEN_FILES = 64  # of a process; one node has about 20
ROS = (
    'rclpy', 'diagnostic_msgs', 'geometry_msgs', 'lifecycle_msgs', 'nav_msgs', 'rosgraph_msgs',
    'sensor_msgs', 'std_msgs', 'vision_msgs', 'visualization_msgs',
)


def ensure(extras: 'Iterable[str]' = EXTRAS, dev: bool = False) -> None:
    """
    Return in an interpreter that has all packages; restart the script in it if necessary.

    Call this before the first import of anything but the standard library.  An error ends the
    script with one line and exit code 2 (nothing was changed), 1 (a step failed) or 130
    (Ctrl-C).

    Parameters
    ----------
    extras : iterable of str
        Which of `EXTRAS` the script needs, or of their `PARTS`.
    dev : bool
        Whether the packages of the tests and linters are needed as well.

    """
    locks = {'runtime', *(PARTS.get(name, (name,))[0] for name in extras)}
    locks |= {'dev'} if dev else set()
    if INSTALLED:
        return _check_extras(extras)
    missing = [name for name in ROS if importlib.util.find_spec(name) is None]
    if os.path.realpath(sys.prefix) == os.path.realpath(str(_venv.VENV)):
        if not missing and _venv.is_complete(locks):
            if os.path.isdir(INDEX):
                _venv.give_ros2()
            return _adopt()
        if missing:  # .venv was changed by hand
            _venv.forget()
        _restart(sys._base_executable)  # type: ignore[attr-defined]
    base = 'ros' if 'rclpy' in missing else 'system {}.{}'.format(*sys.version_info)
    if base == 'ros':
        packages, wanted = _venv.packages_of(locks | {'ros'}), locks | {'ros'}
    else:
        _check_ros(missing)
        packages, wanted = _lacking(locks), locks | {base}
        if not packages:
            return _adopt()
    _use_venv(base, wanted | set(packages), packages)


def _use_venv(base: str, wanted: 'set[str]', packages: 'dict[str, str]') -> NoReturn:
    """Restart the script in ``.venv``, which is made or extended where it is not complete."""
    version = '{}.{}'.format(*sys.version_info)
    if not _venv.is_complete(wanted):
        if base == 'ros' and version not in WITH_WHEELS:
            _use_another_python()
        _venv.make(base, wanted, packages)
    elif version in WITH_WHEELS and not (_venv.VENV / 'lib' / f'python{version}').is_dir():
        _steps.say(f'using .venv, although another Python than {version} made it')
    _restart(str(_venv.PYTHON))


def _lacking(locks: 'set[str]') -> 'dict[str, str]':
    """Return the packages of some locks that are not installed beside ROS 2."""
    locked = _venv.packages_of(locks)
    return {name: locked[name] for name in locked if not _is_installed(name)}


def _check_extras(extras: 'Iterable[str]') -> None:
    """End a script that was installed if packages lack that rosdep may not have installed."""
    if extras:
        # By module: a distribution has some of them under another name than PyPI.
        asked = {package for name in extras for package in (
            PARTS[name][1:] if name in PARTS else _venv.asked_of([name]))}
        lacking = sorted(name for name in asked
                         if importlib.util.find_spec(MODULES.get(name, name)) is None)
        if lacking:
            _steps.fail(f'missing: {", ".join(lacking)}; python3 -m pip install '
                        + ' '.join(lacking), 2)
    _adopt()


def _adopt() -> None:
    """Make the packages of the checkout importable, here and in processes started from here."""
    _check_limits()
    sys.path[1:1] = [path for path in SOURCES if path not in sys.path]
    _prepend('PYTHONPATH', SOURCES)
    if os.path.isdir(INDEX):
        _prepend('AMENT_PREFIX_PATH', [sys.prefix])


def _check_limits() -> None:
    """Let this process open files enough, and nobody else write to those that it makes."""
    import resource  # here: not every system has it
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < OPEN_FILES:
        _steps.fail(f'a process may open {hard} files, and {OPEN_FILES} are needed: raise the '
                    f'limit, as with ulimit -n {OPEN_FILES}', 2)
    if soft != resource.RLIM_INFINITY and soft < OPEN_FILES:
        resource.setrlimit(resource.RLIMIT_NOFILE, (OPEN_FILES, hard))
    os.umask(os.umask(0o077) | 0o022)


def _prepend(variable: str, paths: 'list[str]') -> None:
    old = [path for path in os.environ.get(variable, '').split(os.pathsep) if path]
    os.environ[variable] = os.pathsep.join([path for path in paths if path not in old] + old)


def _restart(python: str) -> NoReturn:
    """Run the same script with another interpreter, in place of this process."""
    sys.stdout.flush()
    sys.stderr.flush()
    arguments = getattr(sys, 'orig_argv', [''] + sys.argv)[1:]
    os.execve(python, [python] + arguments, _steps.environ())


def _check_ros(missing: 'list[str]') -> None:
    """End the script if ROS 2 is sourced, but not one that this interpreter can use."""
    folder = Path(str(importlib.util.find_spec('rclpy').origin)).parent  # type: ignore[union-attr]
    distro = os.environ.get('ROS_DISTRO', 'jazzy')
    if distro != 'jazzy':
        _steps.fail(f'ROS 2 {distro} is sourced, but Jazzy is needed: start from another shell', 2)
    if not any((folder / f'_rclpy_pybind11{suffix}').exists() for suffix in EXTENSION_SUFFIXES):
        _steps.fail(f'{folder} is for another Python than {sys.executable}: use that one', 2)
    if missing:
        names = ' '.join('ros-jazzy-' + name.replace('_', '-') for name in missing)
        _steps.fail(f'the sourced ROS 2 lacks packages: sudo apt-get install {names}', 2)


def _is_installed(name: str) -> bool:
    """Return whether a package is installed, under its own name or that of its ROS package."""
    from importlib import metadata  # here: it is slow, and the oldest Pythons lack it
    for known in (name, re.sub('^ros-(jazzy-)?', '', name)):
        with contextlib.suppress(metadata.PackageNotFoundError):
            return bool(metadata.distribution(known))
    return False


def _use_another_python() -> NoReturn:
    """Run the script with a Python that has wheels; end it if there is none."""
    running = 'Python {}.{} cannot be used'.format(*sys.version_info)
    if _venv.is_complete(set()):
        _restart(str(_venv.PYTHON))
    for version in WITH_WHEELS:
        for folder in os.get_exec_path():
            path = os.path.join(folder, f'python{version}')
            with contextlib.suppress(subprocess.SubprocessError, OSError):
                # The file may be a shim without a Python behind it, as those of pyenv.
                python = subprocess.check_output(
                    [path, '-c', 'import ensurepip, sys; print(sys.executable)'],
                    env=_steps.environ(), stderr=subprocess.DEVNULL, timeout=20)
                _steps.say(f'{running}, continuing with {path}')
                _restart(python.decode().strip())
    _steps.fail(f'{running}: install 3.11, 3.12 or 3.13 with its headers and venv (python3.12-dev '
                'and python3.12-venv on Ubuntu 24.04), or source ROS 2 Jazzy', 2)


if sys.version_info < OLDEST:
    _use_another_python()
