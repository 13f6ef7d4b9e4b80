# SPDX-License-Identifier: Apache-2.0
"""A row of the table of performance, and how it is measured."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
import subprocess
from typing import NamedTuple

# What a measurement raises where the machine lacks something, or a run fails.
FAILURES = (AssertionError, OSError, RuntimeError, subprocess.SubprocessError)
_LONGEST = 300  # characters of a reason
_LIMIT = Path('/proc/sys/net/core/rmem_max')


class Row(NamedTuple):
    """What was measured, and whether that meets the goal: None without a goal or a figure."""

    what: str
    measured: str
    goal: str
    met: bool | None

    def line(self) -> str:
        """Return the row in Markdown."""
        met = {True: 'yes', False: 'no', None: ''}[self.met]
        cells = (self.what, self.measured.replace('|', '/'), self.goal, met)
        return f'| {" | ".join(cells)} |'


class Figure(NamedTuple):
    """What a measurement found, as it is shown, and whether it meets the goal."""

    shown: str
    met: bool | None = None


class NotMeasured(RuntimeError):
    """The machine lacks what a measurement needs; the message says what, and the remedy."""


@dataclass(frozen=True)
class Measurement:
    """A row before it is measured; ``measure`` raises one of FAILURES where it cannot be."""

    what: str
    goal: str
    measure: Callable[[], Figure]

    def row(self) -> tuple[Row, bool]:
        """Return the row, and whether it could be measured; if not, the row has the reason."""
        try:
            shown, met = self.measure()
        except FAILURES as error:
            reason = ' '.join(str(error).split())[-_LONGEST:] or type(error).__name__
            return Row(self.what, f'not measured: {reason}', self.goal, None), False
        return Row(self.what, shown, self.goal, met), True


def need_receive_buffer(frame_bytes: int, limit: Path = _LIMIT) -> None:
    """Raise NotMeasured where the system lets a socket hold less than a frame."""
    from lowsnr_common.images.receive_buffer import remedy

    if limit.exists() and int(limit.read_text()) < frame_bytes:
        raise NotMeasured(
            f'frames of {frame_bytes / 1e6:.1f} MB would be lost{remedy(limit)}')
