"""Work beside the frames: a calibration that takes longer than a frame may."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import ThreadPoolExecutor
import sys
from threading import Event
from typing import Any

# How long the work may keep the interpreter from a frame [s]; a frame asks for it many times.
_SWITCH_S = 0.0005


class Superseded(Exception):
    """Nobody waits for the result any more."""


class Tuner:
    """A worker of which the latest result asked for is all that counts."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix='tuner')
        self._given_up = Event()
        self._future: Future[Any] | None = None

    def start(self, work: Callable[..., Any]) -> None:
        """
        Begin work, and give up what was under way.

        Parameters
        ----------
        work
            Takes ``check``, which it calls again and again, and which raises when the result is
            not wanted any more.

        """
        self.give_up()
        sys.setswitchinterval(_SWITCH_S)
        given_up = self._given_up = Event()

        def check() -> None:
            if given_up.is_set():
                raise Superseded

        self._future = self._pool.submit(work, check=check)

    def finished(self) -> Future[Any] | None:
        """Return the work once it is done, and once only."""
        if self._future is None or not self._future.done():
            return None
        done, self._future = self._future, None
        return done

    def give_up(self) -> None:
        """End what is under way, at its next check."""
        self._given_up.set()
        self._future = None

    def close(self) -> None:
        """End what is under way, and wait for that."""
        self.give_up()
        self._pool.shutdown(cancel_futures=True)
