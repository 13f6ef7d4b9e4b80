# SPDX-License-Identifier: Apache-2.0
"""A run that cannot start ends with code 2 and one line that names the culprit and a remedy."""

from contextlib import closing
import errno
import os
import sys
from types import SimpleNamespace

import bringup
from disk import fill
from graph_runs import own_domain
from graph_runs import run_bringup
from keystores import empty_keystore
from lowsnr_bringup.run.results_folder import Account
from lowsnr_eval.scoring.score_tables import ScoreTables
import pytest

USAGE = 2
LONG = 300 * 'x'  # too long for the name of a file
SCENARIO = 'objects: [{id: a, first_frame: 1, last_frame: 9, start: {x_m: 3.0, y_m: 3.0}, legs: '


@pytest.fixture
def refusal(monkeypatch, capsys, tmp_path):
    """Return a function that gives ``bringup.py`` arguments and returns its only line."""
    before = dict(os.environ)  # the command adds to it
    monkeypatch.setenv('ROS_DOMAIN_ID', str(own_domain()))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')

    def run(*arguments):
        monkeypatch.setattr(
            sys, 'argv', ['bringup.py', '--results', str(tmp_path / 'run'), *arguments])
        try:
            code = bringup.main()
        except SystemExit as end:
            code = end.code
        out, err = capsys.readouterr()
        assert (code, out, err.count('\n')) == (USAGE, '', 1), err
        assert not (tmp_path / 'run').exists()
        return err

    yield run
    os.environ.clear()
    os.environ.update(before)


BAD_OPTIONS = [
    (['--detector', 'stt'], ['stt', ' sdt?']),
    (['--scenario', 'exmaple3'], ['exmaple3', ' example3?']),
    (['--snr', 'loud'], ['--snr', "'loud'"]),
    (['--snr', 'nan'], ['--snr', "'nan'"]),
    (['--frames', '0'], ['--frames', "'0'", ' 1']),
    (['--set', 'sdt.max_iteration=3'], ['sdt.max_iteration=3', ' max_iterations?']),
    (['--set', 'sdt.max_iterations=3.5'], ['sdt.max_iterations=3.5', '[1, 64]']),
    (['--set', 'cdt.alpha=0.1'], ['cdt.alpha=0.1', ' sdt, ', ' sensor', ' tracker', ' evaluator']),
    (['--set', 'sensor.sensor.noise_std=0'], ['sensor.sensor.noise_std=0', '(0.0, inf)']),
    (['--lockstep', '--rate', '5'], ['--lockstep', '--rate']),
    (['--camera', '/camera/image_raw', '--replay', '.'], ['--camera', '--replay']),
    (['--camera', '/camera/image_raw', '--lockstep'], ['--camera', '--lockstep']),
    (['--camera', '/camera/image_raw', '--camera-within', '0'], ['--camera-within', "'0'"]),
    (['--scenario', LONG], [LONG]),
    (['--replay', LONG], [LONG]),
    (['--secure', LONG], [LONG]),
    (['--only', 'trackr', '--expect', 'sensor'], ['--only trackr', ' tracker?']),
    (['--expect', 'cdt_detector'], ['--expect cdt_detector', ' sdt_detector?']),
    (['--only', 'sdt', 'sensor', '--expect', 'sensor', 'tracker', 'evaluator'],
     ['sensor: in --only and in --expect']),
    (['--only', 'sdt', 'tracker', '--expect', 'sensor'], ['evaluator: neither', '--expect eval']),
    (['--only', 'evaluator', 'tracker', 'sdt'], ['sensor: neither', '--expect sensor ']),
    (['--expect', 'evaluator', 'tracker', 'sdt', 'sensor'], ['--expect', 'here']),
    (['--expect-within', '0'], ['--expect-within', "'0'"]),
    (['--peers', 'no.such.host.invalid'], ['no.such.host.invalid', 'no address']),
    (['--peers', ''], ['--peers', "''", 'subnet']),
    (['--peers', 'subnet', '127.0.0.1'], ['--peers', 'subnet alone']),
    (['--domain-id', 'x'], ['--domain-id', "'x'"]),
    (['--domain-id', '233'], ["'233'", '[0, 232]']),
]


@pytest.mark.parametrize(('arguments', 'words'), BAD_OPTIONS)
def test_bad_option_is_named_with_the_alternatives(refusal, arguments, words):
    line = refusal(*arguments)
    assert not [word for word in words if word not in line], line


@pytest.mark.parametrize(('arguments', 'words'), [BAD_OPTIONS[0], BAD_OPTIONS[3]])
def test_process_ends_with_the_usage_code_and_the_same_line(refusal, tmp_path, arguments, words):
    done = run_bringup('--results', str(tmp_path / 'run'), *arguments)
    assert (done.returncode, done.stdout) == (USAGE, '')
    assert done.stderr == refusal(*arguments)


@pytest.mark.parametrize(('text', 'words'), [
    (SCENARIO + '[{until_frame: 9, speed_mps: 3.0}]}]', ['object a ', 'frame 7']),
    (SCENARIO + '[{until_frame: 9, speed: 1.0}]}]', ['speed ', ' speed_mps?']),
    (SCENARIO + '[{until_frame: nine}]}]', ["until_frame = 'nine'"]),
    ('frames: [', ['YAML']),
    ('- 1', ['map']),
])
def test_bad_scenario_file_is_named_with_its_fault(refusal, tmp_path, text, words):
    path = tmp_path / 'bad.yaml'
    path.write_text(text)
    line = refusal('--scenario', str(path))
    assert not [word for word in (str(path), *words) if word not in line], line


def test_results_folder_that_cannot_be_made_is_named(refusal, tmp_path):
    (tmp_path / 'file').touch()
    line = refusal('--results', str(tmp_path / 'file' / 'run'))
    assert str(tmp_path / 'file') in line
    assert '--results' in line


def test_folder_that_is_no_keystore_is_named_with_the_command_that_makes_one(refusal, tmp_path):
    line = refusal('--secure', str(tmp_path))
    assert line.startswith(f'bringup.py: {tmp_path}: ')
    assert line.endswith(f'ros2 security create_keystore {tmp_path}\n')


def test_missing_enclaves_are_named_with_the_commands_that_make_them(refusal, tmp_path):
    made = ['/bringup', '/evaluator', '/cdt/tracker', '/sensor']
    keys = empty_keystore(tmp_path / 'keys', made)
    line = refusal('--detector', 'cdt', 'sdt', '--secure', str(keys))
    for node in ('/cdt/cdt_detector', '/sdt/tracker', '/sdt/sdt_detector'):
        assert f'ros2 security create_enclave {keys} {node}' in line
    for node in made:
        assert f'create_enclave {keys} {node} ' not in f'{line.rstrip()} '


def test_enclave_that_the_middleware_does_not_take_is_named(refusal, tmp_path):
    keys = empty_keystore(
        tmp_path / 'keys', ['/bringup', '/evaluator', '/tracker', '/cdt_detector', '/sensor'])
    line = refusal('--detector', 'cdt', '--secure', str(keys))
    assert '--secure' in line
    assert '(/bringup: ' in line


def test_results_on_a_full_disk_start_nothing(small_disk):
    fill(small_disk / 'ballast')
    done = run_bringup('--detector', 'cdt', '--results', str(small_disk / 'run'))
    assert (done.returncode, done.stdout) == (USAGE, '')
    line, = done.stderr.splitlines()
    assert str(small_disk / 'run') in line
    assert os.strerror(errno.ENOSPC) in line
    assert not (small_disk / 'run' / 'log').exists()


def test_summary_that_cannot_be_written_is_said(tmp_path, capsys):
    evaluator = {'detectors': ['cdt'], 'operating_points': ['matched']}
    with closing(ScoreTables(tmp_path, ['cdt'])):
        (tmp_path / 'summary.json').mkdir()
    faults = bringup.present(
        SimpleNamespace(parameters={'/evaluator': evaluator}), tmp_path, Account())
    assert len(faults) == 1
    assert str(tmp_path) in faults[0]
    assert os.strerror(errno.EISDIR) in faults[0]
    assert '0 frames published' in capsys.readouterr().out
