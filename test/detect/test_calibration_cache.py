# SPDX-License-Identifier: Apache-2.0
"""Entries of the cache are whole or made again, whatever is in their place."""

import importlib
import json
import os
from pathlib import Path
import re
import subprocess
import sys
import time

from lowsnr_detect.calibration import cache as calibration_cache
from lowsnr_detect.calibration.operating_point import calibrated
from lowsnr_detect.detectors.cdt import CDT
from lowsnr_detect.detectors.sdt import SDT
from lowsnr_detect.parts.registry import DETECTORS
import pytest

SHAPE = (7, 5)
FEW = {'runs': 40, 'frames': 10}


def spoil_text(text):
    """Return a function that puts a text in place of an entry."""
    return lambda path: path.write_text(text)


def spoil_value(name, value, place=None):
    """Return a function that changes one value, or one item of it, in an entry."""
    def spoil(path):
        found = json.loads(path.read_text())
        if place is None:
            found['record'][name] = value
        else:
            found['record'][name][place] = value
        path.write_text(json.dumps(found))
    return spoil


def shift(path):
    """Set all thresholds of an entry to one that is within an interval as wrong as itself."""
    found = json.loads(path.read_text())
    for name in ('threshold', 'low', 'high'):
        found['record'][name] = [-50.0] * len(found['record'][name])
    path.write_text(json.dumps(found))


SPOILT = {
    **{f'text {text[:12]!r}': spoil_text(text) for text in (
        '', '{"threshold": 3.0', '[]', '{}', '"text"', '\x00', '[' * 100_000, '9' * 5000,
        '{"seal": NaN, "record": {"threshold": NaN}}', '{"seal": 1, "record": 1}')},
    'no text': lambda path: path.write_bytes(b'\xff\xfe'),
    'cut': lambda path: path.write_bytes(path.read_bytes()[:-40]),
    'infinite': spoil_value('threshold', float('inf'), 0),
    'NaN': spoil_value('threshold', float('nan'), 5),
    'not a number': spoil_value('threshold', '3', 0),
    'out of its interval': spoil_value('threshold', -50.0, 5),
    'of another shape': spoil_value('shape', [5, 7]),
    'of other runs': spoil_value('runs', 41),
    'missing': spoil_value('log_odds', None),
    'all -50': shift,
}


@pytest.mark.parametrize('spoil', SPOILT.values(), ids=SPOILT)
def test_entry_that_is_not_as_it_was_written_is_named_and_made_again(tmp_path, spoil):
    found = calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW)
    (path,) = tmp_path.iterdir()
    sound = path.read_text()
    spoil(path)
    with pytest.warns(UserWarning, match=re.escape(str(path))) as warned:
        assert calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW) == found
    assert sum(str(path) in str(one.message) for one in warned) == 1
    assert path.read_text() == sound
    assert list(tmp_path.iterdir()) == [path]


def test_entry_of_another_detector_is_not_used(tmp_path):
    calibrated(SDT(), 0.1, SHAPE, folder=tmp_path, **FEW)
    (other,) = tmp_path.iterdir()
    found = calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW)
    (path,) = set(tmp_path.iterdir()) - {other}
    path.write_text(other.read_text())
    with pytest.warns(UserWarning, match=re.escape(str(path))):
        assert calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW) == found


@pytest.mark.parametrize('name', sorted(DETECTORS))
def test_every_module_that_a_detector_imports_is_part_of_the_key(name):
    files = calibration_cache.code_files(DETECTORS[name])
    used = {
        Path(importlib.import_module(module).__file__) for path in files
        if 'lowsnr_detect' in path.parts and 'calibration' not in path.parts
        for module in re.findall(
            r'(?m)^from (lowsnr_(?:detect|common\.core)[.\w]*) import', path.read_text())}
    used = {path for path in used if path.name != '__init__.py'}
    assert used
    # Adaptive thresholds are not calibrated, and how a detector is found by name says nothing.
    assert {path for path in used - files if path.parent.name != 'adaptive'} == set()


def test_folder_in_place_of_an_entry_costs_only_time(tmp_path):
    found = calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW)
    (path,) = tmp_path.iterdir()
    path.unlink()
    (path / 'more').mkdir(parents=True)
    with pytest.warns(UserWarning, match=re.escape(str(path))) as warned:
        assert calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW) == found
    assert sum(str(path) in str(one.message) for one in warned) == 2
    assert list(tmp_path.iterdir()) == [path]  # and no draft


def test_dangling_link_in_place_of_an_entry_is_replaced(tmp_path):
    found = calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW)
    (path,) = tmp_path.iterdir()
    sound = path.read_text()
    path.unlink()
    path.symlink_to('nowhere')
    assert calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW) == found
    assert path.read_text() == sound
    assert not path.is_symlink()


def test_cache_folder_is_the_users_alone(tmp_path):
    calibrated(CDT(), 0.1, SHAPE, folder=tmp_path / 'cache', **FEW)
    assert (tmp_path / 'cache').stat().st_mode & 0o777 == 0o700


def test_folder_that_cannot_be_written_is_a_warning(tmp_path):
    (tmp_path / 'file').touch()
    with pytest.warns(UserWarning, match=str(tmp_path / 'file' / 'folder')):
        calibrated(CDT(), 0.1, SHAPE, folder=tmp_path / 'file' / 'folder', **FEW)


def test_default_folder_is_the_users_cache(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    calibrated(CDT(), 0.1, SHAPE, **FEW)
    assert len(list((tmp_path / 'lowsnr').glob('*.json'))) == 1
    monkeypatch.delenv('XDG_CACHE_HOME')
    monkeypatch.setenv('HOME', '/home/somebody')
    assert str(calibration_cache.default_folder()) == '/home/somebody/.cache/lowsnr'


def test_user_without_a_home_has_a_cache_folder(monkeypatch):
    for name in ('XDG_CACHE_HOME', 'HOME'):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os, 'getuid', lambda: 987_654)  # which the system does not know
    assert str(calibration_cache.default_folder()) == '/.cache/lowsnr'


FOR_EVER = """
import sys
from pathlib import Path
from lowsnr_detect.calibration.cache import save
while True:
    save(Path(sys.argv[1]), 'key', {'threshold': [1.0] * 2000}, print)
    print(flush=True)
"""


def test_process_that_is_killed_while_it_writes_leaves_a_whole_entry(tmp_path):
    for pause_s in (0.0, 0.001, 0.002, 0.005):
        process = subprocess.Popen(
            [sys.executable, '-c', FOR_EVER, str(tmp_path)], stdout=subprocess.PIPE,
            env={**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)})
        process.stdout.readline()
        time.sleep(pause_s)
        process.kill()
        process.communicate()
        told = []
        assert calibration_cache.load(tmp_path, 'key', told.append) == {'threshold': [1.0] * 2000}
        assert not told
