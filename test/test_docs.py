# SPDX-License-Identifier: Apache-2.0
"""The README is short, its programs print what it shows, and every link leads somewhere."""

import os
from pathlib import Path
import re
import subprocess
import sys
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob('*.md'), *(ROOT / 'docs').glob('*.md'), ROOT / 'test' / 'README.md'])
PROGRAM = re.compile(r'```python\n(import .*?)```\n(?:\n```\n(.*?)```\n)?', re.DOTALL)
LINK = re.compile(r'\]\(([^)\s]+)\)')
SVG = '{http://www.w3.org/2000/svg}'


def programs():
    """Return page, source and shown output of every program that a user could run."""
    return [(path.name, *found) for path in PAGES
            for found in PROGRAM.findall(path.read_text(encoding='utf-8'))]


def anchors(text):
    """Return the anchors that GitHub gives the headings of a page."""
    return {re.sub(r'[^\w\- ]', '', title.lower()).replace(' ', '-')
            for title in re.findall(r'^#+ (.+)$', text, re.MULTILINE)}


def dead_links(path, text):
    """Yield the links of a page that lead nowhere in this checkout."""
    for to in LINK.findall(text):
        name, _, anchor = to.partition('#')
        if to.startswith('http'):
            continue
        target = path.parent / name if name else path
        if not target.exists() or (
                anchor and anchor not in anchors(target.read_text(encoding='utf-8'))):
            yield to


def test_readme_is_short():
    assert (ROOT / 'README.md').stat().st_size <= 8 * 1024


def test_every_page_is_in_the_readme():
    text = (ROOT / 'README.md').read_text(encoding='utf-8')
    assert {f'docs/{path.name}' for path in (ROOT / 'docs').glob('*.md')} <= set(
        LINK.findall(text))


@pytest.mark.parametrize('path', PAGES, ids=lambda path: path.name)
def test_every_link_leads_somewhere(path):
    assert not list(dead_links(path, path.read_text(encoding='utf-8')))


@pytest.mark.parametrize('link', ['no_such_page.md', '#no-such-heading', 'README.md#nowhere'])
def test_link_that_leads_nowhere_is_seen(link):
    assert list(dead_links(ROOT / 'README.md', f'[x]({link})')) == [link]


@pytest.mark.parametrize(('page', 'source', 'shown'), programs(), ids=lambda text: text[:20])
def test_program_prints_what_is_shown(page, source, shown):
    sources = os.pathsep.join(map(str, (ROOT / 'src').glob('lowsnr*')))
    done = subprocess.run(
        [sys.executable, '-c', source], capture_output=True, text=True, timeout=240, check=False,
        env=os.environ | {'PYTHONPATH': sources})
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
    if shown:
        assert done.stdout == shown, 'python benchmarks/readme.py writes it again'


def test_readme_shows_a_program_with_what_it_prints():
    assert [page for page, _, shown in programs() if shown] == ['README.md']


def test_moving_picture_is_of_the_run(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / 'benchmarks')
    import readme

    def marks(text):
        root = ElementTree.fromstring(text)
        return [[(item.tag, sorted(item.attrib.items())) for item in frame.iter()
                 if item.tag in (f'{SVG}circle', f'{SVG}rect', f'{SVG}path')]
                for frame in root.findall(f"{SVG}g[@class='f']")]

    kept = marks((ROOT / 'docs' / 'run.svg').read_text(encoding='utf-8'))
    assert len(kept) == 40
    assert [len(frame) > 0 for frame in kept[4:35]] == [True] * 31
    assert kept == marks(readme.picture()), 'python benchmarks/readme.py draws it again'
