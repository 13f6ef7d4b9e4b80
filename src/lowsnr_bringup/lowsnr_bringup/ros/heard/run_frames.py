# SPDX-License-Identifier: Apache-2.0
"""The frames of a run as bring-up hears of them: published, and scored."""

from __future__ import annotations

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray
from lowsnr_bringup.run.frame_ledger import FrameLedger
from lowsnr_common.ros.messages import stamp_key
from lowsnr_common.ros.run_records import FrameScored
from rosgraph_msgs.msg import Clock


class RunFrames:
    """
    Counts the frames that the source published and the evaluator scored.

    Parameters
    ----------
    has_source
        Whether a node of the run publishes the frames; of a camera only what the evaluator sees
        is known.
    on_scored
        Called with the number of the frame, and the totals of detections and tracks, for each
        frame that the evaluator has scored.

    """

    def __init__(self, has_source: bool, on_scored: Callable[[int, int, int], None]) -> None:
        self._on_scored = on_scored
        self.ledger, self.newest_ns = FrameLedger(told=has_source), -1
        self.scored = self._detections = self._tracks = 0

    def publish(self, message: Clock) -> None:
        """Count a frame that the source published."""
        stamp = stamp_key(message.clock)
        self.ledger.publish(stamp)
        self.newest_ns = max(self.newest_ns, stamp)

    def score(self, message: DiagnosticArray) -> None:
        """Count a frame that the evaluator scored; Malformed for an unsound record."""
        scored = FrameScored.from_message(message)
        self.ledger.score(scored.stamp_ns, scored.frame)
        self.scored = max(self.scored, scored.frame)
        self._detections += sum(chain.detections for chain in scored.chains)
        self._tracks += sum(chain.tracks for chain in scored.chains)
        self._on_scored(self.scored, self._detections, self._tracks)
