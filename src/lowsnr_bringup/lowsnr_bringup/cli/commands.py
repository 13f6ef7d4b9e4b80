# SPDX-License-Identifier: Apache-2.0
"""
The commands as executables: ``ros2 run lowsnr_bringup bringup``.

A command is a file in ``scripts``, which a checkout runs without an installation.  ``colcon
build`` installs these files with the configuration; here they are found and run as they are.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
import runpy
import sys

from ament_index_python.packages import get_package_share_path

PACKAGE = 'lowsnr_bringup'
COMMANDS = ('bringup', 'calibrate', 'convert', 'evaluate', 'learn_noise', 'reproduce')


def _run(name: str) -> None:
    """Run a command as its file, with the arguments of this process."""
    folder = Path(__file__).parents[2] / 'scripts'
    if not folder.is_dir():  # installed: the files of a package are apart from its modules
        folder = get_package_share_path(PACKAGE) / 'scripts'
    sys.path.insert(0, str(folder))  # for the modules that the commands share
    sys.argv[0] = str(folder / f'{name}.py')
    runpy.run_path(sys.argv[0], run_name='__main__')


bringup, calibrate, convert, evaluate, learn_noise, reproduce = (
    partial(_run, name) for name in COMMANDS)
