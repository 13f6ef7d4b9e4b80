"""Bring-up's manager: what it makes of the messages about a run's frames."""

from diagnostic_msgs.msg import DiagnosticArray
from graph_runs import own_domain
from lowsnr_bringup.ros.manager import Manager
from lowsnr_common.ros.qos import reliable
from lowsnr_common.ros.run_records import ChainCounts
from lowsnr_common.ros.run_records import FrameScored
import pytest
from rclpy.node import Node


@pytest.fixture
def manager(monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(own_domain()))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    made = Manager([], lambda: None, lambda *_: None)
    yield made
    made.close()


def test_message_that_is_no_scored_frame_is_counted_and_named_once(manager, context, capsys):
    node = Node('other', context=context)
    publisher = node.create_publisher(DiagnosticArray, 'scored', reliable(10))
    for _ in range(200):
        if publisher.get_subscription_count():
            break
        manager.spin(0.05)
    for _ in range(3):
        publisher.publish(DiagnosticArray())
    publisher.publish(FrameScored(10**9, 1, (ChainCounts('cdt', 2, 1),)).to_message())
    for _ in range(200):
        if manager.scored:
            break
        manager.spin(0.05)
    assert manager.scored == 1
    assert manager.rejected == {'number of chains': 3}
    line, = capsys.readouterr().err.splitlines()
    assert '/scored' in line
    assert 'number of chains' in line
    # Without a source in the run the frames that the evaluator sees are those published.
    manager.ledger.close(1, 1)
    assert (manager.ledger.published, manager.ledger.unseen, manager.ledger.lost) == (1, 0, 0)
    node.destroy_node()
