# SPDX-License-Identifier: Apache-2.0
"""
Rows of a run on two hosts, of which the detector's is killed and started again.

Two network namespaces are the hosts, so that both share the processors of this machine.
"""

import functools
import json
import os
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory
from typing import Any

from rows.row import Figure
from rows.row import Measurement
from rows.row import need_receive_buffer
from rows.row import NotMeasured

SIDE, RATE_HZ, FRAMES = 1024, 30.0, 900
BACK_WITHIN_S = 3.0
SCENARIO = f'rows: {SIDE}\ncols: {SIDE}\nframes: {FRAMES}\nobjects: []\n'
NEW_NETWORK = ('unshare', '--map-root-user', '--net')
SPLIT_RUN = Path(__file__).resolve().parents[2] / 'test' / 'support' / 'split_run.py'
# Each host has its own discovery.
WIDER = ('ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS', 'ROS_LOCALHOST_ONLY')


def measurements() -> list[Measurement]:
    """Return the rows."""
    what = f'two hosts, {SIDE} x {SIDE}, {RATE_HZ:g} a second, detector host killed: '
    return [
        Measurement(what + 'unanswered but in its outage', '0', unanswered),
        Measurement(what + 'back after its start', f'{BACK_WITHIN_S:g} s', back)]


def unanswered() -> Figure:
    """Count the frames without an answer before and after the outage."""
    found = killed()
    frames, lacking = found['frames'], found['lacking']
    outage = longest_block(lacking)
    lost = frames['unseen'] + frames['lost'] + len(lacking) - outage
    return Figure(f'{lost} of {frames["published"]} ({outage} in {found["away_s"]:.1f} s of '
                  f'outage)', lost == 0 and found['codes'] == [0, 0])


def back() -> Figure:
    """Tell how long after its start the evaluator's host knows that the detector is back."""
    seconds = killed()['start_s']
    return Figure(f'{seconds:.2f} s', seconds <= BACK_WITHIN_S)


@functools.cache
def killed() -> dict[str, Any]:
    """Run both hosts; return what ``split_run.py`` prints."""
    if subprocess.run([*NEW_NETWORK, 'ip', 'link'], capture_output=True, check=False).returncode:
        raise NotMeasured('no right to make network namespaces, or no ip: run as root, with '
                          'iproute2 installed')
    need_receive_buffer(4 * SIDE**2)
    with TemporaryDirectory() as folder:
        scenario = Path(folder) / 'scene.yaml'
        scenario.write_text(SCENARIO, encoding='utf-8')
        plain = {key: value for key, value in os.environ.items() if key not in WIDER}
        done = subprocess.run(
            [*NEW_NETWORK, sys.executable, str(SPLIT_RUN), folder, 'killed', '--scenario',
             str(scenario), '--rate', str(RATE_HZ)],
            env=plain | {'PYTHONPATH': os.pathsep.join(sys.path)}, capture_output=True, text=True,
            check=False, timeout=1800.0)
    if done.returncode:
        raise RuntimeError(done.stderr)
    return dict(json.loads(done.stdout))


def longest_block(numbers: list[int]) -> int:
    """Return the length of the longest run of consecutive numbers, which are ascending."""
    longest = length = 0
    for k, number in enumerate(numbers):
        length = length + 1 if k and number == numbers[k - 1] + 1 else 1
        longest = max(longest, length)
    return longest
