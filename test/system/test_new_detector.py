# SPDX-License-Identifier: Apache-2.0
"""The detector that CONTRIBUTING.md shows, added to a copy of the project: one file."""

import json
from pathlib import Path
import re
import shutil
import subprocess
import sys

from detect.contract import CHECKS
from graph_runs import graph_environment
from graph_runs import own_domain
from graph_runs import ROOT
import pytest

FOLDER = Path('src', 'lowsnr_detect', 'lowsnr_detect', 'detectors')
FILE = FOLDER / 'memory.py'


def example():
    """Return the source that CONTRIBUTING.md shows."""
    text = (ROOT / 'CONTRIBUTING.md').read_text(encoding='utf-8')
    code, = re.findall(r'```python\n(.*?)```', text, re.DOTALL)
    return code


@pytest.fixture(scope='module')
def copy(tmp_path_factory):
    """Return a copy of the project with the new file and no other change."""
    folder = tmp_path_factory.mktemp('copy')
    for name in ('config', 'scripts', 'src', 'test', 'requirements'):
        shutil.copytree(ROOT / name, folder / name)  # with what is compiled
    shutil.copy(ROOT / 'pyproject.toml', folder)
    (folder / FILE).write_text(example(), encoding='utf-8')
    return folder


def run(folder, *command):
    """Run a command of the copy in this interpreter, which has all that it needs."""
    return subprocess.run(
        [sys.executable, *command], cwd=folder, env=graph_environment(own_domain()),
        capture_output=True, text=True, timeout=300.0, check=False)


def imports(source):
    """Return the names that a source imports from the packages of the project."""
    return set(re.findall(r'^from (lowsnr_\S+) import (\w+)$', source, re.MULTILINE))


def test_new_file_is_all_that_a_detector_needs(copy):
    started = run(copy, 'scripts/bringup.py', '--detector', 'memory', 'cdt', '--lockstep',
                  '--results', 'results/run', '--set', 'memory.fading=0.5')
    assert started.returncode == 0, started.stderr
    summary = json.loads((copy / 'results' / 'run' / 'summary.json').read_text())
    assert summary['frames']['scored'] == 40
    assert sorted(summary['detectors']) == ['cdt', 'memory']


def test_whole_contract_runs_on_it(copy):
    rules = [f'test/detect/test_contract.py::test_detector[memory-{check.__name__}]'
             for check in CHECKS]
    tested = run(copy, '-m', 'pytest', '-q', '-p', 'no:cacheprovider', *rules,
                 'test/detect/test_contract.py::test_file_registers_its_detectors[memory]')
    assert tested.returncode == 0, tested.stdout
    assert re.findall(r'(\d+) passed', tested.stdout) == [str(len(CHECKS) + 1)]


@pytest.mark.parametrize('linter', [
    ('ruff', 'check', '--no-cache'),
    ('mypy', '--strict', '--follow-imports=silent', '--cache-dir=/dev/null'),
    ('ament_flake8.main',), ('ament_pep257.main',)], ids=lambda linter: linter[0])
def test_it_passes_the_linters(copy, linter):
    done = run(copy, '-m', *linter, str(FILE))
    assert done.returncode == 0, done.stdout + done.stderr


def test_it_uses_only_what_shipped_detectors_use():
    shipped = [path.read_text(encoding='utf-8') for path in (ROOT / FOLDER).glob('*.py')]
    assert imports(example()) <= set().union(*map(imports, shipped))


def test_it_gets_an_entry_point(copy):
    asked = run(copy, '-c', """
import setuptools
setuptools.setup = lambda **given: print(given['entry_points']['console_scripts'])
import runpy
runpy.run_path('src/lowsnr_detect/setup.py')
""")
    assert "'memory_node = lowsnr_detect.node.detector_node:memory'" in asked.stdout, asked.stderr
