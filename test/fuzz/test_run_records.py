# SPDX-License-Identifier: Apache-2.0
"""Any message on ``scored`` and ``restarts`` is read as a sound record or rejected."""

from fuzz.counting import fuzz
from fuzz.counting import tried
from fuzz.messages import records
from lowsnr_common.ros.run_records import FrameScored
from lowsnr_common.ros.run_records import NodeRestarted


@fuzz('records of a run', 600, message=records())
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
