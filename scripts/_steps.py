# SPDX-License-Identifier: Apache-2.0
"""
Run long commands: a line on the terminal shows their progress, a log keeps their output.

This file also runs on Pythons older than the project's.
"""

from collections.abc import Iterator
import contextlib
import os
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys
import time
from typing import NoReturn
from typing import TextIO

LIVELY = sys.stderr.isatty()
CAUSES = {
    'No space left on device|Disk quota exceeded': 'the disk is full: free some space',
    'Permission denied|Read-only file system': 'the checkout is read-only: use one of your own',
    'DO NOT MATCH THE HASHES': 'the package index has other files than requirements/*.txt locks',
    'NewConnectionError|NameResolutionError|ProtocolError|ProxyError|SSLError|[Tt]imed out|'
    'Network is unreachable|from versions: none':
        'the package index cannot be reached, or has no files for this system: check the network',
}


def say(text: str) -> None:
    """Print a line about the environment on stderr, apart from the output of the script."""
    print(f'lowsnr: {text}', file=sys.stderr, flush=True)


def fail(text: str, code: int = 1) -> NoReturn:
    """End the script with a line that names the fault and the remedy."""
    say(text)
    sys.exit(code)


def environ() -> 'dict[str, str]':
    """Return the environment without the variables that the ROS wheels set for themselves."""
    variables = dict(os.environ)
    if variables.pop('_ROS_WHEELS_BOOTSTRAP_COMPLETE', None):
        variables.pop('LD_LIBRARY_PATH', None)
    return variables


@contextlib.contextmanager
def exclusive_log(path: Path, waiting_for: str) -> 'Iterator[TextIO]':
    """
    Open a log for appending, once no other process or child of one has it open.

    Parameters
    ----------
    path : pathlib.Path
        The log.
    waiting_for : str
        Message to print once, if another process has it open.

    """
    import fcntl  # here: not every system has it
    with path.open('a', encoding='utf-8') as log:
        try:
            fcntl.flock(log, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say(waiting_for)
            fcntl.flock(log, fcntl.LOCK_EX)
        yield log


def run(title: str, command: 'list[str]', log: TextIO, cwd: Path) -> None:
    """
    Run one step; end the script with one line if it fails.

    Parameters
    ----------
    title : str
        Name of the step, shown before its seconds so far and the last line of its output.
    command : list of str
        Program and arguments.
    log : file
        File for the output.
    cwd : pathlib.Path
        Folder to run in.

    """
    start = time.monotonic()
    size = os.fstat(log.fileno()).st_size
    with _noted_signals() as noted:
        print(title, end='' if LIVELY else '\n', file=sys.stderr, flush=True)
        # In its own session: Ctrl-C reaches only this process, which then ends all of the step.
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                                   cwd=str(cwd), env=environ(), start_new_session=True)
        while process.poll() is None and not noted:
            time.sleep(0.1)
            lines = _output(log, size)[-1000:].split('\n')
            _show(f'{title}  {time.monotonic() - start:.0f} s  {lines[-1] or lines[-2:][0]}')
        _show(f'{title}  {time.monotonic() - start:.0f} s', '\n')
        if noted:
            _end(process)
            fail('interrupted; the next start begins again', 128 + noted[0])
    if process.returncode:
        output = _output(log, size)
        reasons = [why for what, why in CAUSES.items() if re.search(what, output)]
        reason = (reasons + output.split('\n')[-2:] + ['no output'])[0]
        fail(f'{title} failed: {reason} (full output: {log.name})')


@contextlib.contextmanager
def _noted_signals() -> 'Iterator[list[int]]':
    """Collect the signals that would end this process, so that it can end its children first."""
    noted: list[int] = []  # not evaluated
    numbers = (signal.SIGHUP, signal.SIGINT, signal.SIGTERM)
    handlers = {number: signal.getsignal(number) for number in numbers}
    for number, handler in handlers.items():
        if handler != signal.SIG_IGN:  # as it is after nohup
            signal.signal(number, lambda number, _: noted.append(number))
    try:
        yield noted
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def _output(log: TextIO, start: int) -> str:
    with open(log.name, 'rb') as written:
        written.seek(start)
        return written.read().decode('utf-8', 'replace').replace('\r', '\n')


def _show(text: str, end: str = '') -> None:
    """Replace the line on the terminal, if stderr is one."""
    if LIVELY:
        width = shutil.get_terminal_size().columns - 1
        print(f'\r{text[:width]:{width}}', end=end, file=sys.stderr, flush=True)


def _end(process: 'subprocess.Popen[bytes]') -> None:
    """End a running step and all its children; pip cleans up after an interrupt."""
    for number in (signal.SIGINT, signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError, subprocess.TimeoutExpired):
            os.killpg(process.pid, number)
            process.wait(timeout=3)
