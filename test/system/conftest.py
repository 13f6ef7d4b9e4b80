# SPDX-License-Identifier: Apache-2.0
"""Graphs for the system tests, and clients beside them."""

from contextlib import ExitStack
import functools

from drain import drain
from graph_client import GraphClient
from graph_runs import own_domain
from graph_runs import start_bringup
from host_faults import HostFaults
from lowsnr_common.ros.qos import reliable
from nav_msgs.msg import Odometry
import pytest
from ros_nodes import spun_node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image
from vision_msgs.msg import Detection2DArray

TOPICS = {
    'image_raw': Image, 'ground_truth': Detection2DArray, 'ground_truth/odometry': Odometry,
    'detections': Detection2DArray, 'tracks': Detection2DArray, 'tracks/odometry': Odometry,
    'clock': Clock,
}


@pytest.fixture
def bringup(tmp_path):
    """Return a function that starts ``bringup.py``; the test's end ends all that it started."""
    with ExitStack() as runs:
        yield lambda *arguments, results='run': runs.enter_context(
            start_bringup(tmp_path / results, *arguments, domain_id=own_domain()))


@pytest.fixture
def client(monkeypatch):
    """Return a client of the test's graph."""
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    with GraphClient(own_domain()) as started:
        yield started


@pytest.fixture
def host_faults(monkeypatch, tmp_path, require_program):
    """Return the faults of the host that the graphs of the test run on."""
    faults = HostFaults(tmp_path, require_program('cc'))
    for name, value in faults.environment.items():
        monkeypatch.setenv(name, value)
    return faults


@pytest.fixture(scope='session')
def published(tmp_path_factory):
    """Return a function that runs CDT on a scenario, once, and returns the messages by topic."""
    @functools.cache
    def run(scenario):
        messages = {topic: [] for topic in TOPICS}
        with spun_node('listener', own_domain()) as (node, executor):
            readers = [node.create_subscription(
                kind, topic, messages[topic].append, reliable(1000))
                for topic, kind in TOPICS.items()]
            # The nodes wait for this listener too, and for the one of the sensor's clock.
            with start_bringup(
                    tmp_path_factory.mktemp('published') / 'run', '--detector', 'cdt',
                    '--scenario', scenario, '--snr', '20', '--rate', '50',
                    '--set', 'cdt.consumers=3', '--set', 'tracker.consumers=2',
                    '--set', 'sensor.observers=1', domain_id=own_domain()) as started:
                while started.process.poll() is None:
                    executor.spin_once(timeout_sec=0.05)
                for reader in readers:
                    drain(reader)
                code, _, err = started.finish()
        assert code == 0, err
        return messages

    return run
