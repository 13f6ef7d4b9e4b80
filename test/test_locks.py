# SPDX-License-Identifier: Apache-2.0
"""Everything that is installed is locked, to a version and to the digests of its files."""

from importlib import metadata
from pathlib import Path
import re
import sys

import _venv
import pytest

ROOT = Path(__file__).resolve().parents[1]
LOCKS = sorted((ROOT / 'requirements').glob('*.txt'))
PINNED = re.compile(
    r'[a-z\d][\w.-]*==[\w.!+]+( ; [^\\\n]+?)? \\\n( {4}--hash=sha256:[\da-f]{64}( \\)?\n)+')


def unpinned(text):
    """Return what of a lock is neither a comment nor a version with its digests."""
    return PINNED.sub('', re.sub(r'^ *#.*\n', '', text, flags=re.MULTILINE)).strip()


def canonical(name):
    """Return the one spelling of a package's name."""
    return re.sub(r'[-_.]+', '-', name).lower()


def installed():
    """Return the versions of what was installed into the running environment, by name."""
    return {canonical(item.name): item.version
            for item in metadata.distributions(path=[p for p in sys.path if _is_ours(p)])}


def _is_ours(path):
    return Path(path).name == 'site-packages' and Path(path).is_relative_to(sys.prefix)


@pytest.mark.parametrize('path', [*LOCKS, ROOT / 'benchmarks' / 'requirements.txt'],
                         ids=lambda path: f'{path.parent.name}/{path.name}')
def test_every_requirement_has_version_and_digests(path):
    assert unpinned(path.read_text(encoding='utf-8')) == ''


def test_cluster_page_names_the_locks_that_workers_need():
    page = (ROOT / 'docs' / 'cluster.md').read_text(encoding='utf-8')
    named = _venv.packages_of(set(re.findall(r'-r requirements/(\w+)\.txt', page)))
    assert named == _venv.packages_of({'runtime', 'study'})
    assert {'dask', 'distributed'} <= set(named)


@pytest.mark.parametrize('line', [
    'tqdm', 'tqdm>=4', 'tqdm==4.70.1\n', 'tqdm==4.70.1 \\\n    --hash=md5:00\n',
    'tqdm @ https://example.org/tqdm.whl', '--index-url https://example.org', '-e .',
    'tqdm==* \\\n    --hash=sha256:' + 64 * '0' + '\n'])
def test_requirement_without_them_is_seen(line):
    good = 'tqdm==4.70.1 \\\n    --hash=sha256:' + 64 * '0' + '\n'
    assert unpinned(good) == ''
    assert unpinned(good + line) != ''


def test_what_is_installed_is_what_the_locks_say():
    locked = {canonical(name): re.match(r'.+==([^ ]+)', text)[1]
              for name, text in _venv.packages_of({path.stem for path in LOCKS}).items()}
    found = {name: version for name, version in installed().items() if name in locked}
    assert found
    assert found == {name: locked[name] for name in found}
