"""
Run long commands: a line on the terminal shows how far they are, a log has what they print.

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
    'No space left on device|Disk quota exceeded': 'the disk is full, make room',
    'Permission denied|Read-only file system': 'it may not be written, use a checkout of your own',
    'DO NOT MATCH THE HASHES': 'the package index has other files than requirements/*.txt names',
    'NewConnectionError|NameResolutionError|ProtocolError|ProxyError|SSLError|[Tt]imed out|'
    'Network is unreachable|from versions: none':
        'the package index cannot be reached, or has nothing for this system; connect the network',
}


def say(text: str) -> None:
    """Print a line about the environment, apart from what the script itself prints."""
    print(f'lowsnr: {text}', file=sys.stderr, flush=True)


def fail(text: str, code: int = 1) -> NoReturn:
    """End the script with a line that says what to do."""
    say(text)
    sys.exit(code)


def environ() -> 'dict[str, str]':
    """Return the environment without what the ROS wheels set in it for their own interpreter."""
    variables = dict(os.environ)
    if variables.pop('_ROS_WHEELS_BOOTSTRAP_COMPLETE', None):
        variables.pop('LD_LIBRARY_PATH', None)
    return variables


@contextlib.contextmanager
def exclusive_log(path: Path, waiting_for: str) -> 'Iterator[TextIO]':
    """
    Open a log for appending once no other process has it, those it started included.

    Parameters
    ----------
    path : pathlib.Path
        The log.
    waiting_for : str
        What to say, once, where another process has it.

    """
    import fcntl  # only now: not everywhere
    with path.open('a', encoding='utf-8') as log:
        try:
            fcntl.flock(log, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say(waiting_for)
            fcntl.flock(log, fcntl.LOCK_EX)
        yield log


def run(title: str, command: 'list[str]', log: TextIO, cwd: Path) -> None:
    """
    Take one step; end the script in one line where it fails.

    Parameters
    ----------
    title : str
        What is shown beside the seconds it has taken and the last line of its output.
    command : list of str
        Program and arguments.
    log : file
        Takes the output.
    cwd : pathlib.Path
        Folder to run in.

    """
    start = time.monotonic()
    size = os.fstat(log.fileno()).st_size
    with _noted_signals() as noted:
        print(title, end='' if LIVELY else '\n', file=sys.stderr, flush=True)
        # In a session of its own, so that Ctrl-C comes to us alone and we end all it started.
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                                   cwd=str(cwd), env=environ(), start_new_session=True)
        while process.poll() is None and not noted:
            time.sleep(0.1)
            lines = _output(log, size)[-1000:].split('\n')
            _show(f'{title}  {time.monotonic() - start:.0f} s  {lines[-1] or lines[-2:][0]}')
        _show(f'{title}  {time.monotonic() - start:.0f} s', '\n')
        if noted:
            _end(process)
            fail('interrupted; the next start begins anew', 128 + noted[0])
    if process.returncode:
        output = _output(log, size)
        reasons = [why for what, why in CAUSES.items() if re.search(what, output)]
        reason = (reasons + output.split('\n')[-2:] + ['no output'])[0]
        fail(f'{title} failed: {reason} (all of it is in {log.name})')


@contextlib.contextmanager
def _noted_signals() -> 'Iterator[list[int]]':
    """Note the signals that would end us, while there are processes to end before."""
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
    """Show a line in place of the one shown before, where there is somebody to see it."""
    if LIVELY:
        width = shutil.get_terminal_size().columns - 1
        print(f'\r{text[:width]:{width}}', end=end, file=sys.stderr, flush=True)


def _end(process: 'subprocess.Popen[bytes]') -> None:
    """End a step that goes on, and all that it started; pip clears up after an interrupt."""
    for number in (signal.SIGINT, signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError, subprocess.TimeoutExpired):
            os.killpg(process.pid, number)
            process.wait(timeout=3)
