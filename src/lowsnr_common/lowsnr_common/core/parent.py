"""End a node when the process that started it has ended."""

from __future__ import annotations

import os
import signal
import threading

LIFELINE = 'LOWSNR_LIFELINE'


def follow_parent() -> None:
    """
    End this process by SIGTERM once the pipe from the parent closes.

    The parent keeps the write end of a pipe, and names the read end in the environment variable
    ``LOWSNR_LIFELINE``.  Without that variable this function does nothing.
    """
    pipe = os.environ.pop(LIFELINE, None)
    if pipe is not None:
        threading.Thread(target=_wait_for_end, args=(int(pipe),), daemon=True).start()


def _wait_for_end(pipe: int) -> None:
    while os.read(pipe, 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)
