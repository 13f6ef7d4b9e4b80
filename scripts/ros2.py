#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The ros2 command: that of an installed ROS 2 where there is one, otherwise a small one."""

import os
from pathlib import Path
import shlex
import shutil
import sys

import _environment
import _steps
import _venv

OWN = 'ros2.py'  # the name of this file, to which .venv/bin/ros2 of every checkout leads
# What decides which nodes a process discovers.
DECIDING = (
    'ROS_DOMAIN_ID', 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS', 'ROS_LOCALHOST_ONLY',
    'RMW_IMPLEMENTATION', 'FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE',
    'CYCLONEDDS_URI', 'ROS_SECURITY_KEYSTORE', 'ROS_SECURITY_ENABLE', 'ROS_SECURITY_STRATEGY')


def main() -> int:
    """Become the installed command, or run the small one; return its exit code."""
    installed = installed_command()
    if installed is not None:
        os.execve(installed, [installed, *sys.argv[1:]], _steps.environ())
    _environment.ensure(('bags', 'files') if sys.argv[1:2] in (['bag'], ['run']) else ())
    from lowsnr_bringup.cli.ros.command import main as run
    return run()


def installed_command() -> 'str | None':
    """Return the ros2 of an installed ROS 2 on the path, not that of a checkout like this."""
    for folder in os.get_exec_path():
        found = shutil.which('ros2', path=folder)
        if found and os.path.basename(os.path.realpath(found)) != OWN:
            return found
    return None


def line_to_copy(*arguments: str) -> str:
    """Return the line that runs ros2 in another terminal on the graph of this process."""
    domain = {'ROS_DOMAIN_ID': '0'}
    variables = {name: os.environ[name] for name in DECIDING if os.environ.get(name)}
    parts = [f'{name}={shlex.quote(value)}' for name, value in (domain | variables).items()]
    installed = installed_command()
    if installed is None:
        return ' '.join([*parts, shlex.join([str(_venv.ROOT / 'scripts' / OWN), *arguments])])
    setup = Path(installed).parents[1] / 'setup.sh'
    source = f'. {shlex.quote(str(setup))} && ' if setup.is_file() else ''
    return source + ' '.join([*parts, shlex.join([installed, *arguments])])


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
