# SPDX-License-Identifier: Apache-2.0
"""A fault names what strangers have named, and nothing of it acts in a terminal or a log."""

from lowsnr_common.ros.diagnostics import Fault
from lowsnr_common.ros.diagnostics import faults_of
from lowsnr_common.ros.diagnostics import Health

HOSTILE = '/\x1b[2J\nbringup.py: all is well'


def test_name_of_a_stranger_is_shown_escaped():
    fault = Fault(HOSTILE, 'several publishers', f'2 publishers: {HOSTILE}')
    status = Health().status('/tracker', [fault], {})
    assert status.message == str(fault) == (
        r'/\x1b[2J\nbringup.py: all is well: 2 publishers: /\x1b[2J\nbringup.py: all is well')
    assert all(key.isprintable() and text.isprintable()
               for key, text in faults_of(status).items())
