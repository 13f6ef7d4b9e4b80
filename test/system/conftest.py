"""Graphs for the system tests, and a listener beside them."""

from contextlib import ExitStack

from graph_runs import own_domain
from graph_runs import start_bringup
from intruder import INJECTED
from intruder import Intruder
from lowsnr_common.ros.inputs import drain
from lowsnr_common.ros.qos import reliable
from machine import Machine
from nav_msgs.msg import Odometry
from onlooker import onlooker
import pytest
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
    """Return a function that starts ``bringup.py``; whatever it started ends with the test."""
    with ExitStack() as runs:
        yield lambda *arguments, results='run': runs.enter_context(
            start_bringup(tmp_path / results, *arguments, domain_id=own_domain()))


@pytest.fixture
def intruder(monkeypatch):
    """Return a stranger on the domain of the test's graph."""
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    with Intruder(own_domain()) as stranger:
        yield stranger


@pytest.fixture
def machine(monkeypatch, tmp_path, require_program):
    """Return the machine of the graphs that the test starts, of which much can be broken."""
    broken = Machine(tmp_path, require_program('cc'))
    for name, value in broken.environment.items():
        monkeypatch.setenv(name, value)
    return broken


def pytest_terminal_summary(terminalreporter):
    """Say how many faults the tests injected."""
    if INJECTED:
        terminalreporter.write_line(
            f'{sum(INJECTED.values())} faults injected, of {len(INJECTED)} kinds')


@pytest.fixture
def hear(bringup):
    """Return a function that runs CDT on a scenario and returns the messages by topic."""

    def run(*arguments):
        messages = {topic: [] for topic in TOPICS}
        with onlooker('listener') as (node, executor):
            readers = [node.create_subscription(
                kind, topic, messages[topic].append, reliable(1000))
                for topic, kind in TOPICS.items()]
            # The listener is one more reader that the nodes wait for, of the sensor's clock too.
            started = bringup(
                '--detector', 'cdt', '--rate', '50', '--set', 'cdt.consumers=3',
                '--set', 'tracker.consumers=2', '--set', 'sensor.observers=1', *arguments)
            while started.process.poll() is None:
                executor.spin_once(timeout_sec=0.05)
            for reader in readers:
                drain(reader)
        code, _, err = started.finish()
        assert code == 0, err
        return messages

    return run
