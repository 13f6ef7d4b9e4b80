# SPDX-License-Identifier: Apache-2.0
"""A node that hangs is told from one that computes, waits for a disk, or reports late."""

from contextlib import contextmanager
import itertools
from pathlib import Path
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

from lowsnr_bringup.plan.graph import Node
from lowsnr_bringup.run.hang_watch import HangWatch
from lowsnr_bringup.run.hang_watch import NEVER_REPORTED
from lowsnr_bringup.run.hang_watch import Pulse
from lowsnr_bringup.run.hang_watch import SILENT
from lowsnr_bringup.run.hang_watch import STOOD_STILL
from lowsnr_bringup.run.processes import NodeProcess
from lowsnr_bringup.run.threads import Patience
from lowsnr_bringup.run.threads import Threads
from lowsnr_bringup.run.threads import threads_of
import pytest

NODE = Node('tracker', 'lowsnr_track.tracker_node')
LOOKS_S = 0.5
# Programs whose only difference is what the main thread does.
SLEEPS = 'import time; print(flush=True); time.sleep(600)'
TICKS = 'import time; print(flush=True)\nwhile True: time.sleep(0.01)'
COMPUTES = 'print(flush=True)\nwhile True: pass'
DEADLOCKED = 'import threading; print(flush=True); threading.Lock().acquire(); ' \
             'lock = threading.Lock(); lock.acquire(); lock.acquire()'


@contextmanager
def started(program):
    """Start a Python program that has printed a line."""
    with subprocess.Popen([sys.executable, '-c', program], stdout=subprocess.PIPE) as process:
        try:
            process.stdout.readline()
            time.sleep(0.05)
            yield process
        finally:
            process.kill()


def looked_at(process, times=5):
    """Return how often a thread of a process was busy, and whether its main thread moved."""
    looks = []
    for _ in range(times):
        looks.append(threads_of(process.pid))
        time.sleep(0.05)
    return sum(look.busy for look in looks), looks[0].switches != looks[-1].switches


@pytest.mark.parametrize('program', [SLEEPS, DEADLOCKED])
def test_a_thread_that_waits_for_ever_is_neither_busy_nor_scheduled(program):
    with started(program) as process:
        assert looked_at(process) == (0, False)


def test_a_thread_that_ticks_is_scheduled():
    with started(TICKS) as process:
        assert looked_at(process)[1]


def test_a_thread_that_computes_is_busy_until_it_is_stopped():
    with started(COMPUTES) as process:
        assert looked_at(process)[0] == 5
        process.send_signal(signal.SIGSTOP)
        time.sleep(0.05)
        assert looked_at(process) == (0, False)
        process.send_signal(signal.SIGCONT)


def test_a_process_that_is_gone_says_nothing():
    with started(SLEEPS) as process:
        process.kill()
        process.wait()
        assert threads_of(process.pid) is None


@pytest.mark.parametrize(('looks', 'over_s'), [
    ([Threads(False, 0)], 2.1),  # it has nothing to do
    ([None], 2.1),  # the system does not say what it does
    ([Threads(True, 0)], 30.1),  # it computes, or waits for a processor
    ([Threads(True, 0)] * 9 + [Threads(False, 0)], 20.1)])  # it computes nine tenths of the time
def test_a_process_is_waited_for_while_it_is_busy(looks, over_s):
    ticks = itertools.count()
    times = itertools.count(0.0, 0.1)
    patience = Patience(
        1, idle_s=1.99, look=lambda _: looks[next(ticks) % len(looks)], clock=lambda: next(times))
    looked = next(n for n in itertools.count(1) if patience.is_over())
    assert 0.1 * looked == pytest.approx(over_s, abs=0.15)


@pytest.mark.parametrize(('program', 'over'), [(SLEEPS, True), (COMPUTES, False)])
def test_the_wait_for_a_process_depends_on_what_it_does(program, over):
    with started(program) as process:
        patience = Patience(process.pid, idle_s=0.2)
        until = time.monotonic() + 0.6
        while time.monotonic() < until and not patience.is_over():
            time.sleep(0.02)
        assert patience.is_over() == over


def pulse_after(looks, within_s=10.0, reported=True):
    """Return the pulse of a process after looks half a second apart."""
    pulse = Pulse(within_s)
    if reported:
        pulse.report()
    for look in looks:
        pulse.look(look, LOOKS_S)
    return pulse


def ticking(count, every=1, busy=False):
    """Return looks at a process whose main thread is scheduled at each so-manieth look."""
    return [Threads(busy, n // every) for n in range(count)]


@pytest.mark.parametrize(('looks', 'reported', 'hangs'), [
    (ticking(22, every=1000), True, STOOD_STILL),  # 10.5 s
    (ticking(20, every=1000), True, ''),  # 9.5 s
    (ticking(22, every=1000), False, STOOD_STILL),
    (ticking(1000, every=1000, busy=True), True, ''),  # computes, or waits for the disk
    (ticking(1000, every=1000, busy=True), False, ''),
    (ticking(1000), True, ''),  # its reports do not arrive
    (ticking(22), False, NEVER_REPORTED),
    (ticking(1000, every=19), True, ''),  # waits in pieces of less than ten seconds
    (ticking(1202, busy=True), True, SILENT),  # 601 s
    ([None] * 1000, False, ''),  # a system that does not say
    ([None] * 1202, False, SILENT)])
def test_how_a_process_hangs(looks, reported, hangs):
    assert pulse_after(looks, reported=reported).hangs == hangs


def test_a_report_begins_anew():
    pulse = pulse_after(ticking(22, every=1000))
    pulse.report()
    assert (pulse.hangs, pulse.silent_s) == ('', 0.0)


def test_other_threads_that_run_now_and_then_hide_no_deadlock():
    looks = [Threads(busy=n % 4 == 0, switches=0) for n in range(60)]
    assert pulse_after(looks).hangs == STOOD_STILL


class Bench:
    """A watch over one process whose threads, reports and clock the test sets."""

    def __init__(self, within_s):
        self.now_s, self.threads, self.heard = 100.0, Threads(False, 0), {}
        process = SimpleNamespace(pid=4711, poll=lambda: None)
        self.member = NodeProcess(NODE, process, Path('tracker.log'), None)
        self.watch = HangWatch(within_s, lambda pid: self.threads, lambda: self.now_s)

    def report(self, process='4711'):
        """Have the node report."""
        self.heard[NODE.path] = process, self.now_s

    def hangs_after(self, seconds, step_s=0.25):
        """Return after how many seconds the watch finds that the node hangs; None if never."""
        start_s = self.now_s
        while self.now_s - start_s < seconds:
            self.now_s += step_s
            if self.watch.update([self.member], self.heard):
                return self.now_s - start_s
        return None


@pytest.mark.parametrize(('within_s', 'found_s'), [(10.0, 10.0), (6.0, 6.0), (0.1, 4.0)])
def test_a_node_that_stops_is_found_in_time(within_s, found_s):
    bench = Bench(within_s)
    bench.report()
    bench.watch.update([bench.member], bench.heard)
    assert found_s < bench.hangs_after(60.0) < found_s + 2.0


def test_a_report_of_another_process_of_the_name_is_no_sign_of_life():
    bench = Bench(10.0)
    for _ in range(15):
        bench.report(process='4712')
        if (found := bench.hangs_after(1.0)) is not None:
            break
    assert found


def test_time_in_which_bringup_did_not_run_does_not_count():
    bench = Bench(10.0)
    bench.report()
    assert bench.hangs_after(3000.0, step_s=1000.0) is None


def test_a_silent_node_is_named_once_and_when_it_reports_again(capsys):
    bench = Bench(10.0)
    bench.threads = Threads(True, 0)
    bench.report()
    assert bench.hangs_after(60.0) is None
    bench.report()
    assert bench.hangs_after(1.0) is None
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert all(' tracker ' in line for line in lines)
    assert 'computes' in lines[0]


def test_a_node_that_hangs_is_named_once_for_each_way(capsys):
    bench = Bench(10.0)
    bench.report()
    for _ in range(40):
        bench.now_s += LOOKS_S
        for member, how in bench.watch.update([bench.member], bench.heard).items():
            bench.watch.name(member, how, '')
    line, = capsys.readouterr().err.splitlines()
    assert STOOD_STILL in line
