"""Any message on ``scored`` and ``restarts`` is read as a sound record or rejected."""

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue
from fuzz.counting import fuzz
from fuzz.counting import tried
from fuzz.strategies import names
from fuzz.strategies import numbers
from fuzz.strategies import whole
from hypothesis import strategies as st
from lowsnr_common.ros.run_records import FrameScored
from lowsnr_common.ros.run_records import NodeRestarted

texts = names | numbers.map(str) | whole.filter(lambda value: abs(value) < 10**400).map(str) | (
    st.integers(0, 99).map(str))
sendable = texts.filter(lambda text: '\0' not in text)
keys = st.sampled_from(['frame', 'detections', 'tracks', 'started_s_ago']) | sendable
# Mostly sound, so that many are read.
counts = st.integers(0, 99).map(str) | sendable
right = st.fixed_dictionaries(dict.fromkeys(('frame', 'detections', 'tracks'), counts))
values = st.dictionaries(keys, sendable, max_size=4) | right | (
    st.fixed_dictionaries({'started_s_ago': sendable}))


@st.composite
def messages(draw):
    """Return an array of statuses that anybody could publish."""
    message = DiagnosticArray()
    message.header.stamp.sec = draw(st.sampled_from([0, 1, -1, 2**31 - 1, -2**31]))
    message.header.stamp.nanosec = draw(st.sampled_from([0, 10**9 - 1, 10**9, 2**32 - 1]))
    for _ in range(draw(st.integers(0, 3))):
        pairs = [KeyValue(key=key, value=value) for key, value in draw(values).items()]
        message.status.append(DiagnosticStatus(
            name=draw(sendable | st.just('/evaluator')), values=pairs))
    return message


@fuzz('records of a run', 600, message=messages())
def test_any_message_is_a_sound_record_or_rejected(message):
    scored = tried('', FrameScored.from_message, message)
    restarted = tried('', NodeRestarted.from_message, message)
    if scored is not None:
        found = [scored.frame] + [
            count for each in scored.chains for count in (each.detections, each.tracks)]
        assert scored.frame > 0
        assert all(type(count) is int and 0 <= count < 10**15 for count in found)
        assert 0 <= scored.stamp_ns < 2**31 * 10**9
        assert FrameScored.from_message(scored.to_message()) == scored
    if restarted is not None:
        assert 0.0 <= restarted.started_s_ago <= 3600.0
        assert restarted.node.startswith('/')
