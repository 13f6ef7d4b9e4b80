# SPDX-License-Identifier: Apache-2.0
"""The build fails where a public name of the sources is in no page of the API."""

import ast
from collections.abc import Iterator
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util import logging

LOG = logging.getLogger(__name__)
SOURCES = Path(__file__).resolve().parents[2] / 'src'


def public_names(source: str) -> Iterator[str]:
    """Yield the public classes and functions of a module, and the public methods of classes."""
    for item in ast.parse(source).body:
        if not isinstance(item, (ast.ClassDef, ast.FunctionDef)) or item.name.startswith('_'):
            continue
        yield item.name
        for part in item.body if isinstance(item, ast.ClassDef) else ():
            if isinstance(part, ast.FunctionDef) and not part.name.startswith('_'):
                yield f'{item.name}.{part.name}'


def missing_names(documented: set[str]) -> Iterator[str]:
    """Yield the public names of all packages that are not documented."""
    for package in sorted(SOURCES.glob('lowsnr*')):
        for path in sorted((package / package.name).rglob('*.py')):
            words = path.relative_to(package).with_suffix('').parts
            module = '.'.join(words).removesuffix('.__init__')
            for name in public_names(path.read_text(encoding='utf-8')):
                if f'{module}.{name}' not in documented:
                    yield f'{module}.{name}'


def check(app: Sphinx, env: BuildEnvironment) -> None:
    """Warn of every public name without an entry."""
    for name in missing_names(set(env.domains['py'].objects)):
        LOG.warning('%s is in no page of the API', name)


def setup(app: Sphinx) -> dict[str, bool]:
    """Check at the end of reading."""
    app.connect('env-check-consistency', check)
    return {'parallel_read_safe': True, 'parallel_write_safe': True}
