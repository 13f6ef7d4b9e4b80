# SPDX-License-Identifier: Apache-2.0
"""
Links from the pages to folders of the repository, and the pages that show the parameter files.

On a forge a link such as ``../config`` leads to the folder.  In the manual it leads to the page
that stands for it; a folder without such a page is named and not linked.
"""

from pathlib import Path
import re

from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[2]
FILES = ('common', 'detectors', 'tracker', 'conditioner', 'evaluator')
PAGES = {'config': 'generated/configuration.rst', 'config/scenarios': 'generated/scenarios.rst'}
LINK = re.compile(r'\[([^\]]+)\]\(\.\./([^)#]+)\)')


def write_pages(app: Sphinx) -> None:
    """Write the pages with the parameter files and the scenarios."""
    folder = Path(app.srcdir, 'generated')
    folder.mkdir(exist_ok=True)
    (folder / 'configuration.rst').write_text(shown(
        'Parameter files', 'The defaults of all nodes. The comments say what each value means, '
        'its bounds, and when to change it.', [f'{name}.yaml' for name in FILES]))
    (folder / 'scenarios.rst').write_text(shown(
        'Scenarios', 'What the sensor can simulate; ``--scenario NAME`` takes one of them, or '
        'a file of your own.', sorted(
            f'scenarios/{path.name}' for path in (ROOT / 'config' / 'scenarios').glob('*.yaml'))))


def shown(title: str, text: str, names: list[str]) -> str:
    """Return a page that shows files of ``config``."""
    parts = [title, '=' * len(title), '', text, '']
    for name in names:
        head = f'config/{name}'
        parts += [head, '-' * len(head), '', f'.. literalinclude:: ../../config/{name}',
                  '   :language: yaml', '']
    return '\n'.join(parts)


def lead_to_pages(app: Sphinx, name: str, content: list[str]) -> None:
    """Replace the links of a page to folders of the repository."""
    if app.env.doc2path(name).suffix == '.md':
        content[0] = LINK.sub(page_of, content[0])


def page_of(link: re.Match[str]) -> str:
    """Return what a link to a file or folder of the repository becomes."""
    text, target = link.groups()
    if not (ROOT / target).is_dir():
        return link[0]
    package, *modules = Path(target).parts[1:] if target.startswith('src/') else [target]
    if modules:  # the page of a folder has the name that Python gives it
        return f'[{text}](generated/api/{package}/{".".join(modules)}.rst)'
    return f'[{text}]({PAGES[target]})' if target in PAGES else text


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages before Sphinx looks for its sources."""
    app.connect('builder-inited', write_pages)
    app.connect('source-read', lead_to_pages)
    return {'parallel_read_safe': True, 'parallel_write_safe': True}
