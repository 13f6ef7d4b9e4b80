# SPDX-License-Identifier: Apache-2.0
"""Every source states its licence in its first lines, as SPDX has it."""

from pathlib import Path
import tomllib

import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = (
    '.ci', '.devcontainer', '.github', 'benchmarks', 'config', 'interfaces', 'scripts', 'src',
    'test')
KINDS = ('.py', '.yaml', '.yml', '.toml', '.cff', '.js', '.css')
NAMES = ('CMakeLists.txt', 'Dockerfile', 'run', 'setup.cfg')


def sources():
    """Return all files that can hold a comment and have code or settings."""
    found = [*ROOT.iterdir(), *(path for name in FOLDERS for path in (ROOT / name).rglob('*'))]
    return sorted(path for path in found if path.is_file() and not path.is_symlink() and (
        path.suffix in KINDS or path.name in NAMES))


def states_licence(text):
    """Return whether the licence stands in the first line, or below that of a program."""
    lines = text.splitlines()[:2]
    at = 1 if lines and lines[0].startswith('#!') else 0
    line = lines[at].strip('#/* ') if len(lines) > at else ''
    return line == f'SPDX-License-Identifier: {licence()}'


def licence():
    """Return the licence of the project."""
    return tomllib.loads((ROOT / 'pyproject.toml').read_text('utf-8'))['project']['license']


def test_every_source_states_the_licence():
    paths = sources()
    assert len(paths) > 400
    assert not [str(path.relative_to(ROOT)) for path in paths
                if not states_licence(path.read_text('utf-8'))]


@pytest.mark.parametrize(('text', 'stated'), [
    ('# SPDX-License-Identifier: Apache-2.0\n"""Doc."""\n', True),
    ('#!/bin/sh\n# SPDX-License-Identifier: Apache-2.0\n', True),
    ('/* SPDX-License-Identifier: Apache-2.0 */\n', True),
    ('# SPDX-License-Identifier: MIT\n', False), ('"""Doc."""\n', False), ('', False),
    ('"""Doc."""\n\n# SPDX-License-Identifier: Apache-2.0\n', False)])
def test_missing_or_other_licence_is_seen(text, stated):
    assert states_licence(text) is stated
