"""Run every linter and every test."""

import argparse
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

import _environment

ROOT = Path(__file__).resolve().parents[1]
LINTERS = {
    'ruff': ['ruff', 'check', '--quiet'],
    'mypy': ['mypy', '--no-error-summary'],
    'ament_flake8': ['ament_flake8.main', 'scripts', 'src', 'test'],
    'ament_pep257': ['ament_pep257.main', 'scripts', 'src', 'test'],
}
FILE_LISTS = ('checking ', 'Checked files:', '* ')  # what the ament linters say of every file
DONE, FAILED, USAGE, INTERRUPTED = 0, 1, 2, 130
# What pytest.main returns, where it is neither 0 nor a failure of ours.
EXIT_CODES = {0: DONE, 2: INTERRUPTED, 4: USAGE}


def main() -> int:
    """Check everything, also after a failure; return the exit code."""
    pytest_args = parse_arguments()
    _environment.ensure(dev=True)
    os.chdir(ROOT)
    # The tests stop the processes they started however they end: let SIGTERM unwind them too.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    start = time.monotonic()
    results = {name: run_linter(name) for name in LINTERS}
    results['pytest'] = run_tests(pytest_args)
    summarize(results, time.monotonic() - start)
    return max(results.values())


def parse_arguments() -> list[str]:
    """Return the arguments for pytest; ``--help`` ends here."""
    parser = argparse.ArgumentParser(
        allow_abbrev=False,
        description='Run ruff, mypy, ament_flake8, ament_pep257 and the tests. Other arguments '
        'go to pytest; paths are relative to the repository.',
        epilog='example: python scripts/test.py test/detect -k sdt -m "not slow"; '
        'exit code: 0 all passed, 1 something failed, 2 usage error, 130 after Ctrl-C',
    )
    parser.parse_known_args()
    return sys.argv[1:]


def run_linter(name: str) -> int:
    """Run one linter; what it prints is shown only where it found something."""
    print(f'== {name}', flush=True)
    command = [sys.executable, '-m', *LINTERS[name]]
    done = subprocess.run(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    if done.returncode:
        lines = done.stdout.splitlines()
        print(*(line for line in lines if not line.startswith(FILE_LISTS)), sep='\n', flush=True)
    return FAILED if done.returncode else DONE


def run_tests(arguments: list[str]) -> int:
    """Run pytest in this process, so that Ctrl-C reaches the tests and nothing else."""
    import pytest  # only now: the interpreter that was started first may not have it

    print('== pytest', flush=True)
    # The packages' own linter tests are for colcon; what they check was checked above.
    ours = ['--ignore-glob=*/test_linters.py', '--continue-on-collection-errors']
    return EXIT_CODES.get(pytest.main([*ours, *arguments]), FAILED)


def summarize(results: dict[str, int], seconds: float) -> None:
    """Print the one line that says how it went."""
    failed = [name for name, code in results.items() if code]
    if INTERRUPTED in results.values():
        verdict = 'interrupted'
    else:
        verdict = f'FAILED: {", ".join(failed)}' if failed else f'passed: {", ".join(results)}'
    print(f'== {verdict} ({seconds:.0f} s)')


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        print('== interrupted')
        sys.exit(INTERRUPTED)
