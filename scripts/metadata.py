# SPDX-License-Identifier: Apache-2.0
"""Write version, maintainer, addresses and parameters to the files that state them."""

from collections.abc import Iterator
from pathlib import Path
import re
import sys
import tomllib
from typing import Any
from xml.sax.saxutils import escape
from xml.sax.saxutils import quoteattr

from _arguments import Parser
from _arguments import ROOT
import _environment
import _parameters


def main() -> int:
    """Write the files that differ from what they should be; return the exit code."""
    Parser(
        prog='metadata.py', description=__doc__ + '  They stand in pyproject.toml, the version in '
        'src/lowsnr/lowsnr/__init__.py, and its date in CHANGELOG.md.',
        epilog='example: python scripts/metadata.py; exit code: 0 done').parse_args()
    _environment.ensure(())
    for path, text in (*stated(ROOT), (_parameters.TABLE, parameters(ROOT / 'config'))):
        if path.read_text(encoding='utf-8') != text:
            path.write_text(text, encoding='utf-8')
            print(f'wrote {path.relative_to(ROOT)}')
    return 0


def stated(root: Path) -> Iterator[tuple[Path, str]]:
    """Yield every file that states version, maintainer or addresses, and what it should be."""
    project = tomllib.loads((root / 'pyproject.toml').read_text(encoding='utf-8'))['project']
    version = re.findall(
        r"^__version__ = '(.+)'", (root / 'src/lowsnr/lowsnr/__init__.py').read_text('utf-8'),
        re.MULTILINE)[0]
    for path in sorted(root.glob('src/*/package.xml')):
        yield path, manifest(path.read_text(encoding='utf-8'), project, version)
    urls, maintainer = project['urls'], project['maintainers'][0]
    for name, values in (
            ('CITATION.cff', {
                'version': version, 'url': urls['website'],
                'repository-code': urls['repository']}),
            ('SECURITY.md', {'mail': maintainer['email']})):
        yield root / name, filled((root / name).read_text(encoding='utf-8'), values)


def parameters(config: Path) -> str:
    """Return the table of all parameters, with the values of a folder of parameter files."""
    from lowsnr_bringup.plan.config_files import describe_parameters
    from lowsnr_bringup.plan.config_files import load_config
    from lowsnr_bringup.plan.graph import KINDS
    from lowsnr_detect.parts.registry import detector_class
    from lowsnr_detect.parts.registry import DETECTORS

    detector_class('sdt')  # the detectors register themselves
    found: dict[str, list[tuple[str, str, str, str]]] = {}
    for name, *row in describe_parameters(load_config(config), sorted(DETECTORS)):
        node, _, key = name.partition('.')
        value, allowed, text = map(str, row)
        found.setdefault(node, []).append((key, value, allowed, text))
    return _parameters.as_table(
        _parameters.config_digest(config), {name: found[name] for name in sorted(DETECTORS)},
        {name: found[name] for name in KINDS})


def manifest(text: str, project: dict[str, Any], version: str) -> str:
    """Return a package.xml with version, maintainers and addresses."""
    lines = [f'  <maintainer email={quoteattr(who["email"])}>{escape(who["name"])}</maintainer>'
             for who in project['maintainers']]
    urls = [f'  <url type={quoteattr(kind)}>{escape(url)}</url>'
            for kind, url in project['urls'].items()]
    text = re.sub('<version>.*</version>', f'<version>{version}</version>', text)
    text = re.sub(r'( +<maintainer .*\n)+', lambda _: '\n'.join(lines) + '\n', text)
    text = re.sub(r'( +<url .*\n)*', '', text)
    return text.replace('</license>\n', '</license>\n' + '\n'.join(urls) + '\n')


def filled(text: str, values: dict[str, str]) -> str:
    """Return a text in which the first ``key: value`` of each key has its value."""
    for key, value in values.items():
        before, found, rest = re.split(f'(^{key}: ).*$', text, maxsplit=1, flags=re.MULTILINE)
        text = before + found + value + rest
    return text


if __name__ == '__main__':
    sys.exit(main())
