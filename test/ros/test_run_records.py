# SPDX-License-Identifier: Apache-2.0
"""The records on ``scored`` and ``restarts``: read back as written, or rejected with a reason."""

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue
from lowsnr_common.core.records import AlarmRate
from lowsnr_common.core.records import Malformed
from lowsnr_common.ros.run_records import ChainCounts
from lowsnr_common.ros.run_records import FrameScored
from lowsnr_common.ros.run_records import NodeRestarted
from lowsnr_common.ros.run_records import rate_from_message
from lowsnr_common.ros.run_records import rate_to_message
import pytest
from rclpy.serialization import deserialize_message
from rclpy.serialization import serialize_message

SCORED = FrameScored(7_000_000_123, 7, (ChainCounts('cdt', 0, 2), ChainCounts('sdt', 10_000, 0)))
RESTARTED = NodeRestarted('/cdt/tracker', 'was killed by SIGKILL', 1.25)
COUNTS = {'frame': '7', 'detections': '0', 'tracks': '2'}


@pytest.mark.parametrize('record', [
    SCORED, FrameScored(0, 1, (ChainCounts('', 0, 0),)), RESTARTED,
    NodeRestarted('/a', '', 0.0), NodeRestarted('/a', 'x' * 10_000, 3600.0)])
def test_record_is_read_back_from_the_wire(record):
    data = serialize_message(record.to_message())
    assert type(record).from_message(deserialize_message(data, DiagnosticArray)) == record


@pytest.mark.parametrize('rate', [
    AlarmRate(), AlarmRate(0.01, 0.0), AlarmRate(1e-9, 1.0), AlarmRate(None, 0.123456789)])
def test_false_alarm_rate_is_read_back_from_the_wire(rate):
    data = serialize_message(rate_to_message('/sdt/sdt_detector', rate))
    assert rate_from_message(deserialize_message(data, DiagnosticArray)) == (
        '/sdt/sdt_detector', rate)


@pytest.mark.parametrize(('values', 'reason'), [
    ({'asked': '0.1'}, 'wrong keys'), ({'asked': '0.1', 'measured': 'nan'}, 'not a share'),
    ({'asked': '1.1', 'measured': ''}, 'not a share'),
    ({'asked': '-0.1', 'measured': ''}, 'not a share')])
def test_false_alarm_rate_that_is_none_is_rejected(values, reason):
    with pytest.raises(Malformed) as caught:
        rate_from_message(DiagnosticArray(status=[status('/sdt_detector', **values)]))
    assert caught.value.reason == reason


def test_messages_are_what_other_programs_read():
    first, second = SCORED.to_message().status
    assert (first.name, {item.key: item.value for item in first.values}) == ('cdt', COUNTS)
    assert second.values[1].value == '10000'
    status, = RESTARTED.to_message().status
    assert (status.name, status.level) == ('/cdt/tracker', DiagnosticStatus.WARN)
    assert status.values == [KeyValue(key='started_s_ago', value='1.250')]


def status(name='cdt', **values):
    return DiagnosticStatus(
        name=name, values=[KeyValue(key=key, value=value) for key, value in values.items()])


def scored(*chains, sec=7, nanosec=0):
    message = DiagnosticArray(status=list(chains))
    message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
    return message


@pytest.mark.parametrize(('message', 'reason'), [
    (scored(), 'number of chains'),
    (scored(*[status(**COUNTS)] * 1001), 'number of chains'),
    (scored(status(**COUNTS), sec=-1), 'not a stamp'),
    (scored(status(**COUNTS), nanosec=1_000_000_000), 'not a stamp'),
    (scored(status('x' * 256, **COUNTS)), 'name too long'),
    (scored(status(**COUNTS), status(**COUNTS)), 'name of two chains'),
    (scored(status(**COUNTS), status('sdt', **COUNTS | {'frame': '8'})), 'number of the frame'),
    (scored(status(**COUNTS | {'frame': '0'})), 'number of the frame'),
    (scored(status()), 'wrong keys'),
    (scored(status(frame='7', detections='0')), 'wrong keys'),
    (scored(status(**COUNTS, more='0')), 'wrong keys'),
    (scored(DiagnosticStatus(values=[KeyValue(key='frame', value='7')] * 3)), 'wrong keys'),
    *((scored(status(**COUNTS | {'tracks': text})), 'not a count') for text in (
        '', '-1', '1.0', '1e3', ' 1', '1_0', '٣', 'nan', '0x1', '1\n', '9' * 16, '9' * 100_000))])
def test_unsound_message_on_scored_is_rejected_with_its_reason(message, reason):
    with pytest.raises(Malformed) as caught:
        FrameScored.from_message(message)
    assert caught.value.reason == reason
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(('statuses', 'reason'), [
    ([], 'number of nodes'),
    ([status('/a', started_s_ago='1')] * 2, 'number of nodes'),
    ([status('a', started_s_ago='1')], 'not a full name'),
    ([status('/' + 'x' * 255, started_s_ago='1')], 'name too long'),
    ([status('/a')], 'wrong keys'),
    ([status('/a', started_s_ago='1', more='1')], 'wrong keys'),
    *(([status('/a', started_s_ago=text)], 'not a time') for text in (
        '', '-1', '3600.001', '1e3', 'nan', 'inf', '1_0', '٣', '1.', '9' * 100_000))])
def test_unsound_message_on_restarts_is_rejected_with_its_reason(statuses, reason):
    with pytest.raises(Malformed) as caught:
        NodeRestarted.from_message(DiagnosticArray(status=statuses))
    assert caught.value.reason == reason
    assert len(str(caught.value)) < 300
