# SPDX-License-Identifier: Apache-2.0
"""The signals that ask a run to end: where they end it at once, and where they wait."""

import os
import signal

from lowsnr_bringup.run.stop_signals import StopSignals
import pytest

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.mark.parametrize('number', SIGNALS)
def test_a_signal_interrupts_but_not_what_must_be_done(number):
    before = [signal.getsignal(each) for each in SIGNALS]
    with StopSignals() as stop:
        with stop.deferred():
            for count in (1, 2):
                os.kill(os.getpid(), number)
                assert stop.count == count
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), number)
        assert stop.count == 3
    assert [signal.getsignal(each) for each in SIGNALS] == before


def test_a_hangup_that_is_to_be_ignored_stays_ignored():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with StopSignals() as stop:
            os.kill(os.getpid(), signal.SIGHUP)
            assert stop.count == 0
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
