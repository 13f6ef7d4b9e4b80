"""A checkout without an environment, for the tests of the environment."""

from pathlib import Path
import shutil

import pytest

ROOT = Path(__file__).resolve().parents[2]
# The first start pretends to be an older Python; the one that replaces it does not.
SCRIPT = """
import os, sys
if os.environ.pop('OLD_PYTHON', ''):
    sys.version_info = (3, 9, 2, 'final', 0)
import _environment
_environment.ensure()
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
