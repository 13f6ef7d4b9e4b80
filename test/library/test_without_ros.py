# SPDX-License-Identifier: Apache-2.0
"""The library runs with four packages, from the checkout and from its wheel."""

import json
import os
from pathlib import Path
import subprocess
import sys
import tomllib
import venv
from zipfile import ZipFile

import _venv
import pytest
from test_architecture import is_edge
from test_architecture import package_modules

ROOT = Path(__file__).resolve().parents[2]
# What "pip install lowsnr" brings.
ALLOWED = {'numpy', 'scipy', 'numba', 'llvmlite', 'yaml', '_yaml', 'lowsnr'}
PROGRAM = """
import json, sys
import numpy as np
import lowsnr
simulation = lowsnr.simulate('example4', snr_db=20.0, seed=4)
white = lowsnr.track(
    simulation.frames, 'sdt', 20.0, progress=True,
    settings={'sdt.operating_point': 'manual', 'sdt.threshold': 20.0})
camera = lowsnr.track(np.rint(100.0 + 8.0 * simulation.frames).astype(np.uint8), 'auto', 8.0)
print(json.dumps([white.tracks.tolist(), camera.detections.tolist(), camera.conditioned]))
"""
FRAME = """
import json
import lowsnr
frame = lowsnr.simulate('example4').truth.to_pandas()
assert len(frame) == 31
print(json.dumps({name: str(kind) for name, kind in frame.dtypes.items()}))
"""
# The checkout, however the tests were started.
CHECKOUT = os.environ | {'PYTHONPATH': os.pathsep.join(map(str, (ROOT / 'src').glob('lowsnr*')))}
# An import of anything else fails, as where it is not installed.
REFUSE = f"""
import sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        top = name.partition('.')[0]
        if top not in sys.stdlib_module_names and top not in {ALLOWED!r} and not (
                top.startswith(('lowsnr_', '_cy', 'cython', '_ni_', '_sysconfig'))):
            raise ModuleNotFoundError(f'No module named {{name!r}}', name=name)
sys.meta_path.insert(0, Refuse())
"""


def answers(python, program, **how):
    """Run a program and return what it prints."""
    done = subprocess.run(
        [python, '-c', program], capture_output=True, text=True, timeout=600, check=False, **how)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_nothing_but_the_four_packages_is_imported():
    white, camera, conditioned = answers(sys.executable, REFUSE + PROGRAM, env=CHECKOUT)
    assert len(white) > 15
    assert conditioned
    assert camera


def wheel_of_source(folder, python, environ, pip):
    """Build a wheel from the source distribution: what it lacks, a package index lacks."""
    project = tomllib.loads((ROOT / 'pyproject.toml').read_text())
    pip('install', '--target', str(folder / 'build'), *project['build-system']['requires'])
    subprocess.run(
        [python, '-m', 'hatchling', 'build', '-t', 'sdist', '-d', str(folder)], check=True,
        env=environ | {'PYTHONPATH': str(folder / 'build')}, cwd=ROOT, capture_output=True)
    (source,) = folder.glob('*.tar.gz')
    pip('wheel', '--no-deps', '--wheel-dir', str(folder), str(source))
    (wheel,) = folder.glob('*.whl')
    return wheel


def check_content(names):
    """Assert that a wheel has every module without ROS, the configuration, and nothing twice."""
    assert len(set(names)) == len(names)
    modules = {name.removesuffix('.py').replace('/', '.') for name in names
               if name.endswith('.py') and not name.endswith('__init__.py')}
    assert modules == {
        module.name for path, module in package_modules()
        if path.name != '__init__.py' and not is_edge(module.name)}
    folder = 'lowsnr/config/'
    assert {name.removeprefix(folder) for name in names if name.startswith(folder)} == {
        str(path.relative_to(ROOT / 'config')) for path in (ROOT / 'config').rglob('*')
        if path.is_file()}


@pytest.mark.slow
def test_wheel_in_an_environment_without_ros_gives_the_same(tmp_path):
    environ = {key: os.environ[key] for key in os.environ if key not in (
        'PYTHONPATH', 'AMENT_PREFIX_PATH', 'LD_LIBRARY_PATH')}
    venv.create(tmp_path / 'env', with_pip=True)
    python = str(tmp_path / 'env' / 'bin' / 'python')

    def pip(*words):
        return subprocess.run([python, '-m', 'pip', *words], check=True, env=environ,
                              cwd=tmp_path, capture_output=True, text=True, timeout=600).stdout

    locked = _venv.packages_of({'runtime'})
    (tmp_path / 'versions.txt').write_text('\n'.join(
        locked[name].split()[0] for name in ('llvmlite', 'numba', 'numpy', 'pyyaml', 'scipy')))
    wheel = wheel_of_source(tmp_path, python, environ, pip)
    check_content(ZipFile(wheel).namelist())
    pip('install', '--constraint', 'versions.txt', str(wheel))
    found = {item['name'].lower() for item in json.loads(pip('list', '--format', 'json'))}
    assert found - {'pip', 'setuptools'} == {
        'llvmlite', 'lowsnr', 'numba', 'numpy', 'pyyaml', 'scipy'}
    assert answers(python, PROGRAM, env=environ, cwd=tmp_path) == answers(
        sys.executable, PROGRAM, env=CHECKOUT)
    pip('install', '--constraint', 'versions.txt', 'pandas')
    columns = answers(python, FRAME, env=environ, cwd=tmp_path)
    assert (columns['frame'], columns['x']) == ('int64', 'float64')
    assert list(columns) == ['frame', 'time_s', 'id', 'x', 'y', 'v_x', 'v_y', 'snr_db']
