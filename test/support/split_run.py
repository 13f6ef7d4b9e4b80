# SPDX-License-Identifier: Apache-2.0
"""
A run in two parts: SDT on one host and all other nodes on another, two network namespaces.

With ``--tiles 1x2`` the second tile of SDT is on the one host, and all else on the other.  This
script runs in a network namespace of its own (``unshare --net``).  Its arguments are a folder,
what happens to the host of the detector (a function below), and options of ``bringup.py``.  It
prints, as JSON, what became of the run.
"""

from contextlib import ExitStack
import json
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import time

from graph_runs import BRINGUP
from graph_runs import GraphRun
from graph_runs import node_processes
from host_faults import HostFaults
from two_hosts import call
from two_hosts import HOST
from two_hosts import OTHER
from two_hosts import other_host

MOST = ['evaluator', 'tracker', 'sensor']
APART, TILE, OTHER_TILE = 'sdt_detector', 'sdt_2', 'sdt_1'
ROWS_BEFORE, OUTAGE_S, STARTS_WITHIN_S = 120, 8.0, 300.0
IS_BACK = 'is back on its host'
LOSS, HOURS = 0.01, 1000.0


class SplitRun:
    """
    The two parts of a run.

    Parameters
    ----------
    folder
        Where results and logs go.
    enter
        The command that enters the namespace of the detector's host.
    options
        Options of ``bringup.py`` for both parts.

    """

    def __init__(self, folder, enter, options):
        self.folder, self._enter, self._options = Path(folder), enter.split(), options
        self.here, self.there = {}, {}  # additions to the environments
        tiled = '--tiles' in options
        self._apart = TILE if tiled else APART
        self._rest = [*MOST, APART, OTHER_TILE] if tiled else MOST
        self._parts = ExitStack()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._parts.close()

    def _start(self, name, enter, arguments, environment):
        results = self.folder / name
        log = self._parts.enter_context((self.folder / f'{name}.log').open('w'))
        return self._parts.enter_context(GraphRun(subprocess.Popen(
            [*enter, sys.executable, str(BRINGUP), '--results', str(results), *arguments,
             *self._options], stdout=log, stderr=log, env=os.environ | environment), results))

    def start_most(self):
        """Start the part with the evaluator."""
        self.most = self._start(
            'most', [], ['--expect', self._apart, '--peers', OTHER], self.here)

    def start_detector(self, name='detector'):
        """Start the part with the detector, also after its end."""
        self.detector = self._start(
            name, self._enter,
            ['--only', self._apart, '--expect', *self._rest, '--peers', HOST], self.there)

    def kill_detector(self):
        """Kill all processes of the detector's part at once, as a host that loses its power."""
        pids = [pid for _, pid in node_processes(self.detector.results)]
        for pid in {*pids, self.detector.process.pid}:
            os.kill(pid, signal.SIGKILL)
        self.detector.process.wait()

    def log(self):
        """Return what the part with the evaluator has printed."""
        return (self.folder / 'most.log').read_text()

    def report(self):
        """Wait for the end; return what became of both parts and of every frame."""
        codes = [run.process.wait(STARTS_WITHIN_S) for run in (self.most, self.detector)]
        lacking = [int(row.split(',')[0]) for row in self.most.rows() if ',detection,' in row
                   and row.split(',')[5] == '']
        return {'codes': codes, 'frames': self.most.summary()['frames'], 'lacking': lacking,
                'restarts': self.most.summary()['restarts'],
                'log': self.log()}


def undisturbed(run):
    """Let the run go on."""
    return {}


def killed(run):
    """Kill the host of the detector, and start it again."""
    killed_s = time.monotonic()
    run.kill_detector()
    run.start_detector('detector-again')
    started_s = time.monotonic()
    while IS_BACK not in run.log():  # the evaluator's part knows of it
        assert time.monotonic() - started_s < STARTS_WITHIN_S, run.log()
        time.sleep(0.01)
    back_s = time.monotonic()
    return {'start_s': back_s - started_s, 'away_s': back_s - killed_s}


def unplugged(run):
    """Pull the wire between the hosts, and put it in again."""
    call('ip link set here down')
    time.sleep(OUTAGE_S)
    call('ip link set here up')
    return {'away_s': OUTAGE_S}


def lossy(run):
    """Lose some of all datagrams from the start on."""
    return {'loss': LOSS}


def clocks(run):
    """Have the clock of the detector's host wrong from the start on."""
    return {'hours': HOURS}


EVENTS = {each.__name__: each for each in (undisturbed, killed, unplugged, lossy, clocks)}


def main(folder, event, *options):
    """Run both parts, have the event happen, and print what became of the frames."""
    with other_host() as enter, SplitRun(folder, enter, options) as run:
        if event in ('lossy', 'clocks'):
            faults = HostFaults(Path(folder), shutil.which('cc'))
            run.there = faults.environment
            if event == 'lossy':
                faults.lose_datagrams(LOSS)
                run.here = faults.environment
            else:
                faults.set_clock(HOURS)
        run.start_most()
        run.start_detector()
        run.most.wait_for_rows(ROWS_BEFORE, STARTS_WITHIN_S)
        found = EVENTS[event](run)
        print(json.dumps(found | run.report()))


if __name__ == '__main__':
    main(*sys.argv[1:])
