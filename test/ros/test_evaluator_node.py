"""The evaluator beside a node that was started again: what it waits for, and what not."""

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue
from lowsnr_common.ros.messages import stamp_from_seconds
from lowsnr_common.ros.qos import reliable
from lowsnr_eval import evaluator_node
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray

TOPICS = ('ground_truth', 'detections', 'tracks')


@pytest.fixture
def evaluator(context, tmp_path):
    values = {'results': str(tmp_path / 'run'), 'detectors': ['cdt'], 'scenario': 'empty',
              'answer_within_s': 600.0}
    node = evaluator_node.EvaluatorNode(context=context, parameter_overrides=[
        Parameter(name, value=value) for name, value in values.items()])
    node.autostart()
    yield node
    node.destroy_node()


@pytest.fixture
def graph(context, evaluator, spin):
    """Return publishers by topic that the evaluator hears, and the stamps that it has scored."""
    node = Node('graph', context=context)
    scored = []
    node.create_subscription(
        DiagnosticArray, 'scored', lambda message: scored.append(message.header.stamp.sec),
        reliable(100))
    kinds = dict.fromkeys(TOPICS, Detection2DArray) | {'restarts': DiagnosticArray}
    publishers = {topic: node.create_publisher(kind, topic, reliable(100))
                  for topic, kind in kinds.items()}
    spin(lambda: evaluator.count_subscribers('scored')
         and all(each.get_subscription_count() for each in publishers.values()), evaluator, node)
    yield publishers, scored
    node.destroy_node()


def array(stamp_s):
    return Detection2DArray(header=Header(stamp=stamp_from_seconds(stamp_s)))


def restart(started_s_ago):
    return DiagnosticArray(status=[DiagnosticStatus(
        name='/cdt_detector', values=[KeyValue(key='started_s_ago', value=str(started_s_ago))])])


@pytest.fixture
def missing(evaluator, graph, spin):
    """Have the truth of a frame come, of which no answer has."""
    publishers, _ = graph
    publishers['ground_truth'].publish(array(1.0))
    spin(lambda: any(item.key.startswith('ground_truth median')
                     for item in evaluator.health.status('', (), {}).values))


@pytest.mark.parametrize('started_s_ago', [0.0, 60.0], ids=['before the start', 'during it'])
def test_frame_that_a_node_missed_while_it_was_away_is_not_waited_for(
        graph, missing, spin, started_s_ago):
    publishers, scored = graph
    publishers['restarts'].publish(restart(started_s_ago))
    spin(lambda: scored == [1])


def test_frame_that_a_node_heard_while_it_was_starting_is_waited_for(
        graph, missing, spin, tmp_path, monkeypatch):
    monkeypatch.setattr(evaluator_node, '_CAUGHT_UP_S', 60.0)
    publishers, scored = graph
    publishers['restarts'].publish(restart(60.0))
    with pytest.raises(AssertionError):
        spin(lambda: scored, within=3)
    for topic in TOPICS[1:]:
        publishers[topic].publish(array(1.0))
    spin(lambda: scored == [1])
    table = tmp_path / 'run' / 'frames.csv'
    spin(lambda: table.read_text().count('1,1.0,cdt,') == 2)
    assert ',,,,,,' not in table.read_text()
