"""The detector that CONTRIBUTING shows, added to a copy of the project as it says: one file."""

import json
from pathlib import Path
import re
import shutil
import subprocess
import sys

from graph_runs import graph_environment
from graph_runs import own_domain
from graph_runs import ROOT
import pytest

FOLDER = Path('src', 'lowsnr_detect', 'lowsnr_detect', 'detectors')


@pytest.fixture
def copy(tmp_path):
    """Return a copy of the project with the new file and no other change."""
    for name in ('config', 'scripts', 'src', 'test', 'requirements'):
        shutil.copytree(ROOT / name, tmp_path / name)  # with what is compiled
    shutil.copy(ROOT / 'pyproject.toml', tmp_path)
    text = (ROOT / 'CONTRIBUTING.md').read_text(encoding='utf-8')
    code, = re.findall(r'```python\n(.*?)```', text, re.DOTALL)
    (tmp_path / FOLDER / 'memory.py').write_text(code, encoding='utf-8')
    return tmp_path


def run(folder, *command):
    """Run a command of the copy in this interpreter, which has all that it needs."""
    return subprocess.run(
        [sys.executable, *command], cwd=folder, env=graph_environment(own_domain()),
        capture_output=True, text=True, timeout=300.0, check=False)


def test_new_file_is_all_that_a_detector_needs(copy):
    started = run(copy, 'scripts/bringup.py', '--detector', 'memory', 'cdt', '--lockstep',
                  '--results', 'results/run', '--set', 'memory.fading=0.5')
    assert started.returncode == 0, started.stderr
    summary = json.loads((copy / 'results' / 'run' / 'summary.json').read_text())
    assert summary['frames']['scored'] == 40
    assert sorted(summary['detectors']) == ['cdt', 'memory']


def test_contract_tests_find_the_new_detector(copy):
    tested = run(copy, '-m', 'pytest', '-q', 'test/detect/test_contract.py', '-k', 'memory')
    assert tested.returncode == 0, tested.stdout
    assert re.search(r'[5-9]\d* passed', tested.stdout), tested.stdout


def test_it_gets_an_entry_point(copy):
    asked = run(copy, '-c', """
import setuptools
setuptools.setup = lambda **given: print(given['entry_points']['console_scripts'])
import runpy
runpy.run_path('src/lowsnr_detect/setup.py')
""")
    assert "'memory_node = lowsnr_detect.node.detector_node:memory'" in asked.stdout, asked.stderr
