# SPDX-License-Identifier: Apache-2.0
"""The build fails where a page would load something over the network."""

from collections.abc import Iterator
from pathlib import Path
import re

from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

LOADING = re.compile(r'<(?:script|link|img|iframe|source|video)\b[^>]*?\b(?:src|href)="([^"]+)"')
IN_STYLES = re.compile(r'(?:@import|url\()\s*["\']?((?:https?:)?//[^"\')\s]+)')


def loaded(text: str) -> Iterator[str]:
    """Yield the addresses on other hosts that a page or a style sheet loads."""
    for address in LOADING.findall(text):
        if re.match(r'(?:https?:)?//', address):
            yield address
    yield from IN_STYLES.findall(text)


def check(app: Sphinx, error: Exception | None) -> None:
    """Raise an error that names a page which is not complete without the network."""
    for path in () if error else sorted(Path(app.outdir).rglob('*')):
        if path.suffix in ('.html', '.css'):
            for address in loaded(path.read_text(encoding='utf-8')):
                raise ExtensionError(f'{path} loads {address}: put the file into the manual')


def setup(app: Sphinx) -> dict[str, bool]:
    """Check at the end of the build."""
    app.connect('build-finished', check)
    return {'parallel_read_safe': True, 'parallel_write_safe': True}
