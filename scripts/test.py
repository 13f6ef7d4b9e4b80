# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK
"""Run every linter and every test, and build the manual."""

import argparse
from collections.abc import Iterator
import contextlib
from dataclasses import dataclass
import io
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time
from typing import IO

from _arguments import did_you_mean
from _arguments import INTERRUPTED
from _arguments import Parser
from _arguments import USAGE
import _environment
import manual

ROOT = Path(__file__).resolve().parents[1]
OURS = ('scripts', 'src', 'test', 'docs/conf.py', 'docs/extensions')
LINTERS = {
    'ruff': ['ruff', 'check', '--quiet'],
    'mypy': ['mypy', '--no-error-summary'],
    'ament_flake8': ['ament_flake8.main', *OURS],
    'ament_pep257': ['ament_pep257.main', *OURS],
}
MANUAL = {'manual': manual.BUILD}
FILE_LISTS = ('checking ', 'Checked files:', '* ')  # what the ament linters print for every file
PACKAGES = sorted(path.name for path in (ROOT / 'src').glob('lowsnr*'))
DONE, FAILED = 0, 1
LATEST_S = 900.0  # how long after the tests a linter, or the manual, must end
ALIKE = 0.82  # of a misspelt option of this command; options of pytest are less like them
# What pytest.main returns, where it is neither 0 nor a failure of ours.
EXIT_CODES = {0: DONE, 2: INTERRUPTED, 4: USAGE}
# Tests of the graph wait for other processes about as long as they compute.
WORKERS_PER_CORE = 1.5


def main() -> int:
    """Check everything, also after a failure; return the exit code."""
    options, pytest_args = parse_arguments(sys.argv[1:])
    _environment.ensure(dev=True)
    os.chdir(ROOT)
    # The tests stop the processes they started however they end: let SIGTERM unwind them too.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    start = time.monotonic()
    with started_linters(checks(pytest_args)) as linters:
        results = {'pytest': run_tests(pytest_arguments(options) + pytest_args)}
        if results['pytest'] == INTERRUPTED:
            print('== interrupted')
            return INTERRUPTED
        if options.coverage or options.slow:
            print_coverage()
        results |= {linter.name: linter.finish() for linter in linters}
    summarize(results, time.monotonic() - start)
    return max(results.values())


def parse_arguments(arguments: list[str]) -> tuple[argparse.Namespace, list[str]]:
    """Return the options of this command and the arguments for pytest; ``--help`` ends here."""
    parser = Parser(
        prog='test.py',
        description='Run ruff, mypy, ament_flake8, ament_pep257 and, at the same time, the tests '
        'in parallel processes, and build the manual. Other arguments go to pytest, and the '
        'manual is not built; paths are relative to the repository.',
        epilog='example: python scripts/test.py test/detect -k sdt -n0; -n0 runs the tests in one '
        'process, as a debugger needs it. '
        'Exit code: 0 all passed, 1 something failed, 2 usage error, 130 after Ctrl-C',
    )
    parser.add_argument(
        '--slow', action='store_true',
        help='run also the tests marked slow and all fuzzed inputs, and print the coverage')
    parser.add_argument(
        '--coverage', action='store_true',
        help='print the share of lines of each package that the tests run; it takes about half '
        'as long again')
    parser.complete_words()
    options, others = parser.parse_known_args(arguments)
    for word in others:
        if did_you_mean(word, ('--slow', '--coverage', '--version'), ALIKE):
            parser.check_option(word)
    return options, others


def pytest_arguments(options: argparse.Namespace) -> list[str]:
    """Return the arguments for pytest that come before those of the user, who may override."""
    arguments = [
        # The packages' own linter tests are for colcon; the linters above check the same.
        '--ignore-glob=*/test_linters.py', '--continue-on-collection-errors',
        f'--numprocesses={round(WORKERS_PER_CORE * (os.cpu_count() or 1))}', '--dist=loadscope',
        '--no-loadscope-reorder']  # test/conftest.py sorts the tests, and keeps some together
    if not options.slow:
        arguments += ['-m', 'not slow']
    else:
        os.environ.setdefault('LOWSNR_FUZZ', '1')  # all inputs; half of them otherwise
    if options.coverage or options.slow:
        arguments += ['--cov', '--cov-report=']  # of the packages that pyproject.toml names
    return arguments


def checks(pytest_args: list[str]) -> dict[str, list[str]]:
    """Return what runs beside the tests; whoever names some tests waits for no manual."""
    return LINTERS if pytest_args else LINTERS | MANUAL


@dataclass
class Linter:
    """A linter that runs; it prints something only where it found something."""

    name: str
    process: subprocess.Popen[str]
    output: IO[str]
    within_s: float = LATEST_S

    def finish(self) -> int:
        """Wait for its end, not for ever, print what it found; return `DONE` or `FAILED`."""
        print(f'== {self.name}', flush=True)
        try:
            if not self.process.wait(self.within_s):
                return DONE
        except subprocess.TimeoutExpired:
            kill_session(self.process)
            print(f'{self.name} has not ended {self.within_s:g} s after the tests', flush=True)
        self.output.seek(0)
        lines = self.output.read().splitlines()
        print(*(line for line in lines if not line.startswith(FILE_LISTS)), sep='\n', flush=True)
        return FAILED


@contextlib.contextmanager
def started_linters(commands: dict[str, list[str]]) -> Iterator[list[Linter]]:
    """Start commands; at the end of the block they are killed, with what they started."""
    with contextlib.ExitStack() as stack:
        linters = []
        for name, words in commands.items():
            output = stack.enter_context(tempfile.TemporaryFile('w+'))
            process = stack.enter_context(subprocess.Popen(
                [sys.executable, '-m', *words], stdout=output, stderr=subprocess.STDOUT,
                text=True, start_new_session=True))
            stack.callback(kill_session, process)
            linters.append(Linter(name, process, output))
        yield linters


def kill_session(process: subprocess.Popen[str]) -> None:
    """Kill a command that leads a session; nodes of a graph follow their bring-up."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def run_tests(arguments: list[str]) -> int:
    """Run pytest in this process, so that Ctrl-C reaches it and its workers and nothing else."""
    import pytest  # only now: the interpreter that was started first may not have it

    print('== pytest', flush=True)
    return EXIT_CODES.get(pytest.main(arguments), FAILED)


def print_coverage() -> None:
    """Print the share of lines that the tests ran, by package; node processes are left out."""
    import coverage

    measured = coverage.Coverage()
    measured.load()
    print('== coverage of lines, without those that only node processes run')
    for name in [*PACKAGES, '*']:
        share = measured.report(include=f'src/{name}/*', file=io.StringIO())
        print(f'{"total" if name == "*" else name:<16}{share:6.1f} %')


def summarize(results: dict[str, int], seconds: float) -> None:
    """Print the one line that says how it went."""
    failed = [name for name, code in results.items() if code]
    verdict = f'FAILED: {", ".join(failed)}' if failed else f'passed: {", ".join(results)}'
    print(f'== {verdict} ({seconds:.0f} s)')


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        print('== interrupted')
        sys.exit(INTERRUPTED)
