# SPDX-License-Identifier: Apache-2.0
"""Remove what an earlier build took from sources that may be gone since."""

from pathlib import Path
import shutil
from typing import Any

from sphinx.application import Sphinx


def remove_generated(app: Sphinx, config: Any) -> None:
    """Remove all generated pages, unless this is a draft, which keeps their figures."""
    if str(config.sphinx_gallery_conf['plot_gallery']) == 'True':
        shutil.rmtree(Path(app.srcdir) / 'generated', ignore_errors=True)


def setup(app: Sphinx) -> dict[str, bool]:
    """Remove the pages before others are written."""
    app.connect('config-inited', remove_generated, priority=1)
    return {'parallel_read_safe': True, 'parallel_write_safe': True}
