# SPDX-License-Identifier: Apache-2.0
"""A checkout without an environment and an installed ROS 2, for the tests of the environment."""

import importlib.machinery
from pathlib import Path
import shutil

import _venv
import pytest

ROOT = Path(__file__).resolve().parents[2]
ROS = ('rclpy', 'diagnostic_msgs', 'geometry_msgs', 'lifecycle_msgs', 'nav_msgs', 'rosgraph_msgs',
       'sensor_msgs', 'std_msgs', 'vision_msgs', 'visualization_msgs')
# The first start pretends to be an older Python; the one that replaces it does not.
SCRIPT = """
import os, sys
if os.environ.pop('OLD_PYTHON', ''):
    sys.version_info = (3, 9, 2, 'final', 0)
import _environment
_environment.ensure(())
print(sys.prefix, os.environ['PYTHONPATH'], sys.argv[1:])
"""


@pytest.fixture
def checkout(tmp_path):
    """Return a checkout without an environment, with a script that prints where it ended up."""
    root = tmp_path / 'checkout'
    for name in ('requirements', 'interfaces'):
        shutil.copytree(ROOT / name, root / name)
    (root / 'src' / 'lowsnr_any').mkdir(parents=True)
    (root / 'scripts').mkdir()
    for name in ('_environment', '_steps', '_venv'):
        shutil.copy(ROOT / 'scripts' / f'{name}.py', root / 'scripts')
    (root / 'scripts' / 'script.py').write_text(SCRIPT)
    return root


@pytest.fixture
def ros(tmp_path):
    """Return a folder that looks like an installed ROS 2 with all packages."""
    folder = tmp_path / 'ros'
    for name in ROS:
        (folder / name).mkdir(parents=True)
        (folder / name / '__init__.py').touch()
    suffix = importlib.machinery.EXTENSION_SUFFIXES[0]
    (folder / 'rclpy' / f'_rclpy_pybind11{suffix}').touch()
    for name in _venv.packages_of({'runtime'}):
        info = folder / f'{name.replace("-", "_")}-1.dist-info'
        info.mkdir()
        (info / 'METADATA').write_text(f'Name: {name}\nVersion: 1\n')
    return folder
