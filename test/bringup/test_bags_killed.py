# SPDX-License-Identifier: Apache-2.0
"""Bags whose writer was killed, or found the disk full."""

import os
import resource
import signal
import subprocess
import sys

from lowsnr_bringup.bags.reader import Bag
import pytest

STORAGES = ('mcap', 'sqlite3')
WRITER = """
import sys
from pathlib import Path
from lowsnr_bringup.bags.writer import BagWriter
bag = BagWriter(Path(sys.argv[1]), sys.argv[2], {'key': 'text'})
topic = bag.add_topic('/clock', 'rosgraph_msgs/msg/Clock')
number = 0
while True:
    number += 1
    bag.write(topic, bytes(8) + number.to_bytes(4, 'little'), number, number)
    if number % 10_000 == 0:
        bag.sync()
        print(number, flush=True)
"""


def start_writer(folder, storage, **options):
    """Start a process that writes without end, and prints how many messages are safe."""
    return subprocess.Popen(
        [sys.executable, '-c', WRITER, str(folder), storage], stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, env=os.environ | {'PYTHONPATH': os.pathsep.join(
            path for path in sys.path if path)}, **options)


def numbers(bag):
    """Return the numbers of the messages of that process."""
    return [int.from_bytes(item.data[8:12], 'little') for item in bag.messages({'/clock'})]


@pytest.mark.parametrize('storage', STORAGES)
def test_bag_is_readable_up_to_the_last_sync_after_sigkill(tmp_path, storage):
    folder = tmp_path / 'bag'
    with start_writer(folder, storage) as process:
        safe = [int(process.stdout.readline()) for _ in range(5)][-1]
        process.send_signal(signal.SIGKILL)
    with Bag(folder) as bag:
        found = numbers(bag)
        assert bag.custom == {'key': 'text'}
    assert len(found) >= safe
    assert found == list(range(1, len(found) + 1))


@pytest.mark.parametrize('storage', STORAGES)
def test_bag_is_readable_up_to_the_last_sync_after_a_full_disk(tmp_path, storage):
    folder, most = tmp_path / 'bag', 3 * 2**20
    with start_writer(folder, storage, preexec_fn=lambda: resource.setrlimit(
            resource.RLIMIT_FSIZE, (most, most))) as process:
        out, err = process.communicate(timeout=60.0)
    assert process.returncode == 1
    assert err.splitlines()[-1].startswith(('OSError', 'sqlite3.OperationalError'))
    safe = int(out.split()[-1])
    with Bag(folder) as bag:
        found = numbers(bag)
    assert len(found) >= safe >= 10_000
    assert found == list(range(1, len(found) + 1))
