# SPDX-License-Identifier: Apache-2.0
"""The software that the numbers of a report come from."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError
from importlib.metadata import version
from importlib.util import find_spec
import os
from pathlib import Path
import platform
import re
import subprocess
import sys

from lowsnr_bringup.bags.storage import ROS_DISTRO

_PACKAGES = ('numpy', 'scipy', 'numba', 'distributed', 'matplotlib')
_DEFAULT_MIDDLEWARE = 'rmw_fastrtps_cpp'
_WITHIN_S = 5.0


def software() -> list[tuple[str, str]]:
    """Return names and versions; what is not installed is left out."""
    middleware = os.environ.get('RMW_IMPLEMENTATION') or _DEFAULT_MIDDLEWARE
    found = [
        ('lowsnr', ' '.join(filter(None, (_own_version(), _commit())))),
        (f'ROS 2 {os.environ.get("ROS_DISTRO") or ROS_DISTRO}, rclpy', _ros_version('rclpy')),
        (f'middleware {middleware}', _ros_version(middleware)),
        *(('Fast DDS', _ros_version('fastrtps')),) * ('fastrtps' in middleware),
        ('Python', sys.version.split()[0]), *((name, _installed(name)) for name in _PACKAGES),
        ('system', platform.platform(terse=True))]
    return [(name, text) for name, text in found if text]


def _own_version() -> str:
    """Return the version of lowsnr: that of the checkout, or of what is installed."""
    spec = find_spec('lowsnr')
    if spec is not None and spec.origin:
        text = Path(spec.origin).read_text(encoding='utf-8')
        if stated := re.search(r"^__version__ = '(.+)'", text, re.MULTILINE):
            return stated[1]
    return _installed('lowsnr') or _installed('lowsnr_eval')


def _commit() -> str:
    """Return the commit of the checkout, and whether it was changed; empty without one."""
    here = Path(__file__)

    def git(*arguments: str) -> str:
        return subprocess.run(
            ['git', '--no-optional-locks', '-C', str(here.parent), *arguments],
            capture_output=True, text=True, timeout=_WITHIN_S, check=True).stdout.strip()

    try:
        git('ls-files', '--error-unmatch', here.name)  # not the checkout of something else
        changed = git('status', '--porcelain', '--untracked-files=no')
        return f'commit {git("rev-parse", "--short=12", "HEAD")}' + ', changed' * bool(changed)
    except (OSError, subprocess.SubprocessError):
        return ''


def _ros_version(name: str) -> str:
    """Return the version of a ROS package: from its wheel, or of an installed ROS."""
    if found := _installed(f'ros-{name.replace("_", "-")}') or _installed(name):
        return found
    for prefix in filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)):
        path = Path(prefix, 'share', name, 'package.xml')
        if path.is_file():
            stated = re.search('<version>(.+)</version>', path.read_text(encoding='utf-8'))
            return stated[1] if stated else ''
    return ''


def _installed(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ''
