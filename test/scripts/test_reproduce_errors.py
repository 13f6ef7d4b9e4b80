# SPDX-License-Identifier: Apache-2.0
"""Arguments, folders and schedulers that reproduce.py rejects, each in one line."""

from pathlib import Path
import subprocess
import sys

from lowsnr_eval.study.study import StudyOptions
from lowsnr_eval.study.study_folder import open_folder
from lowsnr_eval.study.study_plan import plan_study
import pytest
import reproduce

ROOT = Path(__file__).resolve().parents[2]
SMALL = ['--example', '2', '--snr', '9', '--detector', 'cdt']


def test_help_shows_an_example(capsys):
    with pytest.raises(SystemExit) as end:
        reproduce.reproduce(['--help'])
    assert end.value.code == 0
    assert 'reproduce.py --example 3' in ' '.join(capsys.readouterr().out.split())


@pytest.mark.parametrize(('arguments', 'culprit'), [
    (('--example', '7'), "'7'"),
    (('--example', '2', '--runs', '0'), '--runs'),
    (('--example', '2', '--detector', 'sdr'), "'sdr'"),
    (('--example', '2', '--jobs', '0'), '--jobs'),
    (('--example', '2', '--all'), '--all'),
    ((), '--all'),
])
def test_bad_argument_is_rejected_in_one_line(tmp_path, capsys, arguments, culprit):
    check_rejection([*arguments, '--results', str(tmp_path)], culprit, capsys)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize('address', ['127.0.0.1:9', 'nonsense://'])
def test_scheduler_that_does_not_answer_is_rejected_in_one_line(tmp_path, address):
    command = [sys.executable, ROOT / 'scripts' / 'reproduce.py', '--example', '2',
               '--scheduler', address, '--results', tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240.0)
    assert (done.returncode, done.stdout) == (2, '')
    assert address.partition(':')[0] in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize('more', [(), ('--resume',)])
def test_results_of_another_version_are_left_alone(tmp_path, capsys, more):
    folder = tmp_path / 'example2'
    folder.mkdir()
    (folder / 'study.json').write_text('{"format": 0}')
    check_rejection([*SMALL, '--results', str(tmp_path), *more], str(folder), capsys)
    assert [path.name for path in folder.iterdir()] == ['study.json']


def test_resume_of_another_study_is_rejected(tmp_path, capsys):
    folder = tmp_path / 'example2'
    folder.mkdir()
    options = StudyOptions(example=2, runs=100, snrs_db=(9.0,), detectors=('cdt',))
    open_folder(folder, plan_study(options, ROOT / 'config'), resume=False)
    more = ['--results', str(tmp_path), '--resume']
    check_rejection([*SMALL, '--seed', '3', *more], 'study.options.seed was 0, is 3', capsys)
    assert {path.name for path in folder.iterdir()} == {'study.json', 'runs'}


def check_rejection(arguments, culprit, capsys):
    """Check that the command names the culprit in one line and returns the usage error."""
    try:
        code = reproduce.reproduce(arguments)
    except SystemExit as end:
        code = end.code
    out, err = capsys.readouterr()
    assert (code, out) == (2, '')
    assert culprit in err
    assert len(err.splitlines()) == 1
