# SPDX-License-Identifier: Apache-2.0
"""
The progress of long work on stderr: a bar on a terminal, plain lines elsewhere.

Without tqdm there are plain lines on a terminal too.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from contextlib import contextmanager
import sys
import time

try:
    from tqdm import tqdm
except ImportError:  # a bar is for comfort alone
    tqdm = None

_A_LINE_EVERY_S = 10.0
# A calibration that is at hand shows no progress [s].
_DELAY_S = 0.5


def is_terminal() -> bool:
    """Return whether stderr is a terminal; what a host puts in its place may not know."""
    return bool(getattr(sys.stderr, 'isatty', bool)())


@contextmanager
def progress(
    title: str, total: int, unit: str, *, done: int = 0, delay_s: float = 0.0,
    leave: bool = True,
) -> Iterator[Callable[[int], object]]:
    """
    Show how much of some work is done.

    Parameters
    ----------
    title
        Name of the work.
    total, unit
        Number of its parts, and the name of one.
    done
        Number of parts that an earlier process did; they are no part of the rate.
    delay_s
        Work that takes less time than this shows nothing [s].
    leave
        Whether the last state stays on the terminal.

    Yields
    ------
    callable
        Call it with the number of parts that were done since the last call.

    """
    if tqdm is not None and is_terminal():
        with tqdm(total=total, desc=title, unit=unit, initial=done, delay=delay_s, leave=leave,
                  dynamic_ncols=True) as bar:
            yield bar.update
        return
    lines = _Lines(title, total, unit, done, delay_s)
    try:
        yield lines.update
    finally:
        lines.close()


@contextmanager
def calibration_progress(
    name: str, shape: tuple[int, int], snr_db: float,
) -> Iterator[Callable[[float], None]]:
    """Yield what is called with the share of a detector's calibration that is done."""
    percent = 0
    title = f'calibrating {name} for {shape[1]} x {shape[0]} cells, {snr_db:g} dB, once'
    with progress(title, 100, '%', delay_s=_DELAY_S, leave=False) as advance:
        def show(share: float) -> None:
            nonlocal percent
            advance(round(100 * share) - percent)
            percent = round(100 * share)

        yield show


class _Lines:
    """A line at the begin, one every ten seconds in which a part is done, and one at the end."""

    def __init__(self, title: str, total: int, unit: str, done: int, delay_s: float) -> None:
        self._title, self._of = title, f'of {total} {unit}'
        self._first = self._done = done
        self._start = time.monotonic()
        self._next = self._start + delay_s
        self._shown: int | None = None
        self.update(0)

    def update(self, count: int) -> None:
        self._done += count
        if time.monotonic() >= self._next:
            self._show()

    def close(self) -> None:
        if self._shown not in (None, self._done):
            self._show()

    def _show(self) -> None:
        now = time.monotonic()
        self._next, self._shown = now + _A_LINE_EVERY_S, self._done
        rate = (self._done - self._first) / max(now - self._start, 1e-9)
        print(f'{self._title}: {self._done} {self._of}' + f', {rate:.3g} a second' * (rate > 0.0),
              file=sys.stderr, flush=True)
