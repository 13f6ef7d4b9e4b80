"""The test command's own exit codes, and what becomes of a test without its program."""

from pathlib import Path
import subprocess
import sys

import pytest

COMMAND = Path(__file__).resolve().parents[1] / 'scripts' / 'test.py'
# The command without its linters: they see the repository, not the file that is handed in.
WITHOUT_LINTERS = f"""
import runpy, sys
sys.path.insert(0, {str(COMMAND.parent)!r})
command = runpy.run_path({str(COMMAND)!r})
command['LINTERS'].clear()
sys.exit(command['main']())
"""


@pytest.mark.parametrize(('body', 'code', 'verdict'), [
    ('pass', 0, '== passed: pytest'),
    ('raise AssertionError', 1, '== FAILED: pytest'),
    ('raise KeyboardInterrupt', 130, '== interrupted'),
])
def test_exit_code_says_how_the_tests_went(tmp_path, body, code, verdict):
    path = tmp_path / 'test_one.py'
    path.write_text(f'def test_one():\n    {body}\n')
    done = run('-c', WITHOUT_LINTERS, path)
    assert done.returncode == code
    assert verdict in done.stdout.splitlines()[-1]


def test_file_that_cannot_be_imported_is_a_failure(tmp_path):
    (tmp_path / 'test_broken.py').write_text('import no_such_module\n')
    assert run('-c', WITHOUT_LINTERS, tmp_path / 'test_broken.py').returncode == 1


def test_no_test_at_all_is_a_failure(tmp_path):
    (tmp_path / 'test_none.py').touch()
    assert run('-c', WITHOUT_LINTERS, tmp_path / 'test_none.py').returncode == 1


def test_unknown_option_is_a_usage_error():
    done = run('-c', WITHOUT_LINTERS, '--no-such-option')
    assert done.returncode == 2
    assert '--no-such-option' in done.stderr


def test_help_shows_an_example():
    done = run(COMMAND, '--help')
    assert done.returncode == 0
    assert 'example: python scripts/test.py' in done.stdout


def test_missing_program_skips_on_a_users_machine(monkeypatch, require_program):
    monkeypatch.delenv('CI', raising=False)
    with pytest.raises(pytest.skip.Exception, match='needs the program no-such-program'):
        require_program('no-such-program')


def test_missing_program_fails_in_ci(monkeypatch, require_program):
    monkeypatch.setenv('CI', 'true')
    with pytest.raises(pytest.fail.Exception, match='needs the program no-such-program'):
        require_program('no-such-program')


def test_program_on_the_path_is_found(require_program):
    assert Path(require_program('sh')).name == 'sh'


def run(*arguments):
    """Run Python with these arguments to its end."""
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
