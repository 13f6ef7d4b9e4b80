# SPDX-License-Identifier: Apache-2.0
"""A stranger on the domain writes what only nodes of the run may say: nobody believes it."""

from functools import partial

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue
from graph_client import GraphClient
from graph_runs import own_domain
from lowsnr_common.ros.messages import stamp_from_seconds
from lowsnr_common.ros.qos import reliable
from lowsnr_common.ros.run_records import ChainCounts
from lowsnr_common.ros.run_records import FrameScored
from lowsnr_common.ros.run_records import NodeRestarted
from rcl_interfaces.msg import Parameter
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.msg import ParameterValue
from rosgraph_msgs.msg import Clock
from run_checks import check_none_lost
from run_checks import interrupt
from tally import FAULTS

FORGED = '\x1b[2J\nbringup.py: all is well'
SECOND = 1_000_000_000


def forgeries():
    """Return topics and messages that would end, mislead or stop a run that believed them."""
    counts = {'frame': '9' * 4000, 'detections': '1', 'tracks': '1'}
    digits = DiagnosticArray(status=[DiagnosticStatus(name='cdt', values=[
        KeyValue(key=key, value=value) for key, value in counts.items()])])
    status = DiagnosticStatus(
        name='/tracker', level=DiagnosticStatus.ERROR, message=FORGED, values=[
            KeyValue(key='state', value='unconfigured'), KeyValue(key='process', value='1'),
            KeyValue(key=f'fault: {FORGED} several publishers', value=FORGED)])
    event = ParameterEvent(node='/cdt_detector', changed_parameters=[
        Parameter(name='alpha', value=ParameterValue(type=4, string_value=FORGED))])
    return [
        *(('/clock', Clock(clock=stamp_from_seconds(1e6 + k))) for k in range(421)),
        ('/scored', digits),
        ('/scored', FrameScored(SECOND, 10**9, (ChainCounts('cdt', 1, 1),)).to_message()),
        *(('/restarts', NodeRestarted(node, FORGED, 3600.0).to_message())
          for node in ('/evaluator', '/cdt_detector', '/tracker')),
        ('/parameter_events', event), ('/diagnostics', DiagnosticArray(status=[status]))]


def test_stranger_who_writes_the_bookkeeping_is_named_and_believed_by_nobody(bringup):
    run = bringup('--detector', 'cdt', '--loop', '--rate', '50')
    run.wait_for_rows(10)
    with GraphClient(own_domain(), 'stranger', topics=()) as stranger:
        publishers = {}
        for topic, message in forgeries():
            if topic not in publishers:
                publishers[topic] = stranger.node.create_publisher(
                    type(message), topic, reliable(1000))
            publishers[topic].publish(message)
            FAULTS[f'forged {topic}'] += 1
        for node, topic in (('/sensor', '/clock'), ('/evaluator', '/scored')):
            stranger.wait(partial(stranger.statuses, node, topic, '/stranger'))
        run.kill('detector_node')  # it is started again with what was set, which is nothing
        run.wait_for_restarts(1)
        stranger.spin(1.0)
        readers = {topic: each.get_subscription_count() for topic, each in publishers.items()}
    run.wait_for_rows(len(run.rows()) + 50)
    interrupt(run)
    code, out, err = run.finish()
    assert code == 130
    # The stranger reads /diagnostics itself, the sensor /scored, for its pace in lockstep alone.
    assert readers == dict.fromkeys(publishers, 0) | {'/diagnostics': 1, '/scored': 1}
    assert {row['node'] for row in run.restarts()} == {'cdt_detector'}
    for topic in ('/clock', '/scored'):
        assert any(topic in line and '/stranger' in line for line in err.splitlines()), err
    assert 'all is well' not in out + err
    assert 'unconfigured' not in err
    check_none_lost(run)
