# SPDX-License-Identifier: Apache-2.0
"""The calibration command prints a table, fills the cache, and names what is wrong."""

from concurrent.futures import ThreadPoolExecutor
import os
from pathlib import Path
import subprocess
import sys

import pytest

COMMAND = Path(__file__).resolve().parents[2] / 'scripts' / 'calibrate.py'
SMALL = ('--detector', 'cdt', 'sdt', '--rows', '7', '--cols', '5', '--false-alarm-prob', '0.1')


@pytest.fixture
def calibrate(tmp_path):
    """Return a function that runs the command with a cache of its own."""
    def run(*arguments):
        return subprocess.run(
            [sys.executable, COMMAND, *arguments], capture_output=True, text=True, timeout=120,
            check=False, env={**os.environ, 'XDG_CACHE_HOME': str(tmp_path)})
    return run


def test_table_has_a_row_for_each_detector_and_snr(calibrate, tmp_path):
    done = calibrate(*SMALL, '--snr', '3', '9', '--set', 'sdt.max_iterations=3')
    assert done.returncode == 0, done.stderr
    rows = [line.split() for line in done.stdout.splitlines()]
    assert [row[:2] for row in rows[1:]] == [
        ['cdt', '3'], ['sdt', '3'], ['cdt', '9'], ['sdt', '9']]
    assert len(list((tmp_path / 'lowsnr').glob('*.json'))) == 4
    assert calibrate(*SMALL, '--snr', '3', '9', '--set',
                     'sdt.max_iterations=3').stdout == done.stdout


@pytest.mark.parametrize(('arguments', 'culprit'), [
    (['--detector', 'std'], 'std'),
    (['--snr', 'six'], "'six'"),
    (['--false-alarm-prob', '2'], '--false-alarm-prob'),
    (['--scenario', 'nowhere'], 'nowhere'),
    (['--set', 'sdt.radius=-1'], 'radius')])
def test_wrong_option_is_named_in_one_line(calibrate, arguments, culprit):
    done = calibrate(*arguments)
    assert done.returncode == 2
    assert culprit in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_probabilities_of_a_detector_share_one_curve(calibrate, tmp_path):
    done = calibrate('--detector', 'cdt', '--rows', '7', '--cols', '5', '--false-alarm-prob',
                     '0.1', '0.01', '0.001')
    assert done.returncode == 0, done.stderr
    thresholds = [float(line.split()[6]) for line in done.stdout.splitlines()[1:]]
    assert thresholds == sorted(thresholds)
    assert len(list((tmp_path / 'lowsnr').glob('*.json'))) == 1


def test_damaged_entry_is_named_in_one_line_and_made_again(calibrate, tmp_path):
    done = calibrate(*SMALL)
    paths = sorted((tmp_path / 'lowsnr').glob('*.json'))
    sound = [path.read_bytes() for path in paths]
    for path in paths:
        path.write_bytes(sound[0].replace(b'"seed": 0', b'"seed": 1'))
    again = calibrate(*SMALL)
    assert (again.returncode, again.stdout) == (0, done.stdout)
    named = [line for line in again.stderr.splitlines() if line.startswith('calibrate.py: ')]
    assert sorted(line.split(': ')[1] for line in named) == list(map(str, paths))
    assert [path.read_bytes() for path in paths] == sound


def test_two_at_once_agree_and_leave_whole_entries(calibrate, tmp_path):
    with ThreadPoolExecutor(2) as pool:
        one, other = pool.map(lambda _: calibrate(*SMALL), range(2))
    assert (one.returncode, one.stdout) == (0, other.stdout)
    again = calibrate(*SMALL)
    assert (again.stdout, again.stderr) == (one.stdout, '')
    assert {path.suffix for path in (tmp_path / 'lowsnr').iterdir()} == {'.json'}


def test_help_shows_an_example(calibrate):
    done = calibrate('--help')
    assert done.returncode == 0
    assert 'example: python scripts/calibrate.py' in done.stdout
