# SPDX-License-Identifier: Apache-2.0
"""Row of a run on a camera with large frames of 16 bits, conditioned, not recorded."""

import statistics

import camera_stream
from rows.row import Figure
from rows.row import Measurement
from rows.row import need_receive_buffer

SIDE, RATE_HZ, SECONDS = 4096, 5.0, 60.0


def measurements() -> list[Measurement]:
    """Return the row."""
    return [Measurement(
        f'{SIDE} x {SIDE} of 16 bits, conditioned, {RATE_HZ:g} a second for {SECONDS:g} s: '
        'unanswered', '0', unanswered)]


def unanswered() -> Figure:
    """Count the frames without an answer."""
    need_receive_buffer(2 * SIDE**2)
    found = camera_stream.measure(SIDE, RATE_HZ, SECONDS, 'sdt', record=False)
    lost = found.counted - len(found.spent_ms)
    return Figure(f'{lost} of {found.counted} (median {statistics.median(found.spent_ms):.0f} ms)',
                  lost == 0)
