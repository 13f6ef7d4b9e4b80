# SPDX-License-Identifier: Apache-2.0
"""Progress is a bar on a terminal, and plain lines where stderr is a file or a pipe."""

from contextlib import suppress
import os
import pty
import select
import subprocess
import sys
import termios

from lowsnr_bringup.run import progress as module
from lowsnr_bringup.run.progress import progress
import pytest

WORK = """
from lowsnr_bringup.run.progress import progress
with progress('sorting', 3, 'heaps') as advance:
    for _ in range(3):
        advance(1)
"""


@pytest.fixture
def seconds(monkeypatch):
    """Return a list whose last item is the time that the lines see [s]."""
    times = [0.0]
    monkeypatch.setattr(module.time, 'monotonic', lambda: times[-1])
    return times


def test_a_line_is_printed_at_the_begin_every_ten_seconds_and_at_the_end(seconds, capsys):
    with progress('sorting', 40, 'heaps', done=10) as advance:
        for second in range(1, 26):
            seconds.append(float(second))
            advance(1)
    counts = [line.split()[1] for line in capsys.readouterr().err.splitlines()]
    assert counts == ['10', '20', '30', '35']


def test_rate_leaves_out_what_was_done_before(seconds, capsys):
    with progress('sorting', 100, 'heaps', done=50) as advance:
        seconds.append(10.0)
        advance(20)
    assert capsys.readouterr().err.splitlines()[1:] == ['sorting: 70 of 100 heaps, 2 a second']


def test_short_work_prints_nothing(seconds, capsys):
    with progress('sorting', 2, 'heaps', delay_s=0.5) as advance:
        seconds.append(0.4)
        advance(2)
    assert capsys.readouterr() == ('', '')


def test_work_that_ends_early_shows_how_far_it_came(seconds, capsys):
    with suppress(KeyboardInterrupt), progress('sorting', 9, 'heaps') as advance:
        advance(4)
        raise KeyboardInterrupt
    assert [line.split()[1] for line in capsys.readouterr().err.splitlines()] == ['0', '4']


def test_pipe_gets_whole_lines_and_a_terminal_a_bar():
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)}
    command = [sys.executable, '-c', WORK]
    piped = subprocess.run(
        command, env=environment, stderr=subprocess.PIPE, check=True, timeout=60).stderr
    assert b'\r' not in piped
    assert len(piped.splitlines()) == 2
    main, other = pty.openpty()
    termios.tcsetwinsize(other, (24, 100))
    try:
        subprocess.run(command, env=environment, stderr=other, check=True, timeout=60)
        shown = b''
        while select.select([main], [], [], 0.0)[0]:
            shown += os.read(main, 65536)
    finally:
        os.close(main)
        os.close(other)
    assert b'\r' in shown
    assert b'3/3' in shown
