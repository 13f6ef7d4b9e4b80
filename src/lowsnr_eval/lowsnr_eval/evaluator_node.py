# SPDX-License-Identifier: Apache-2.0
"""The evaluator node: scores the answers of every chain against the truth."""

from __future__ import annotations

from collections import deque
from functools import partial
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.records import Malformed
from lowsnr_common.core.timeline import in_seconds
from lowsnr_common.ros import messages
from lowsnr_common.ros import run_records
from lowsnr_common.ros.bringup_line import LAST_FRAME
from lowsnr_common.ros.frame_maps import FrameMaps
from lowsnr_common.ros.images import image_to_array
from lowsnr_common.ros.inputs import Input
from lowsnr_common.ros.managed_node import ManagedNode
from lowsnr_common.ros.node_main import run
from lowsnr_common.ros.parameters import declare
from lowsnr_common.ros.qos import any_reliability
from lowsnr_common.ros.qos import reliable
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import FrameSettings
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.scene.scene_writer import WAITING
from lowsnr_eval.scoring.frame_join import Arrival
from lowsnr_eval.scoring.run_scoring import RunScorer
from nav_msgs.msg import Odometry
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn
from rosgraph_msgs.msg import Clock
import scipy.optimize  # noqa: F401  (here, so that the first frame does not wait for it)
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray

_FLUSH_EVERY_S = 1.0
# A node that was started again has answered the frames that it received meanwhile after this
# time.
_CAUGHT_UP_S, _MOST_RESTARTED = 1.0, 100
_LATEST_NS = 2**31 * 1_000_000_000


class EvaluatorNode(ManagedNode):
    """Score each frame once every chain has answered it, and announce it on ``scored``."""

    _begun = False  # whether this process has begun the results

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('evaluator', **kwargs)
        self.run = declare(self, RunSettings)
        self.evaluation = declare(self, Evaluation)
        self.frames = declare(self, FrameSettings)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the results and subscribe to truth and answers."""
        self._scorer = RunScorer(
            self.run, self.evaluation,
            lambda text, reason: self.reject('frame', reason, text),
            resumed=self._begun or self.settings.lives > 0, conditioned=self.frames.conditioned)
        self._begun = True
        depth = reliable(self.settings.queue_depth)
        self._restarted: deque[tuple[float, str]] = deque(maxlen=_MOST_RESTARTED)
        self._scored = self.create_publisher(DiagnosticArray, run_records.SCORED, depth)
        self.outputs = {self._scored: self.settings.consumers}
        # Before the answers: a frame is taken before what is later than it.
        self._pictures = self._listen_to_pictures()
        for topic in self._scorer.topics:
            states = self.listen(
                Odometry, f'{topic}/odometry', partial(self._on_state, topic), depth,
                steady=False)
            self.listen(
                Detection2DArray, topic, partial(self._on_array, topic), depth, first=states)
        self.bringup.hear(run_records.RESTARTS, DiagnosticArray, self._on_restart)
        self.bringup.hear(LAST_FRAME, Clock, lambda _: self._scorer.end_frames())
        self.create_timer(_FLUSH_EVERY_S, self._on_timer)
        return TransitionCallbackReturn.SUCCESS

    def _listen_to_pictures(self) -> list[Input]:
        """Subscribe to frames, to their cells if they are conditioned, and to statistics."""
        qos = any_reliability(WAITING)
        found = [self.listen(Image, 'image_raw', self._on_frame, qos)]
        found += [self.listen(Image, topic, partial(self._on_statistic, name), qos)
                  for topic, name in self._scorer.statistics.items()]
        if self.frames.conditioned:
            maps = FrameMaps(self, True, self._on_cells, self._scorer.add_map)
            found.append(self.listen(
                Image, 'conditioned/image_raw', maps.take, qos, first=maps.input))
        return found

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Score what has arrived, and write it to disk."""
        self._take_waiting()
        self._scorer.end_frames()
        self._score(time.monotonic())
        self._scorer.scene.flush()
        self._flush()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the results; a node that is configured again continues them."""
        self._close()
        return super().on_cleanup(state)

    def destroy_node(self) -> None:
        """Close the results, however the node ends."""
        self._close()
        super().destroy_node()

    def _close(self) -> None:
        if scorer := self.__dict__.pop('_scorer', None):
            scorer.end_frames()
            scorer.score(float('inf'))  # nothing more arrives of what it has seen
            scorer.close()

    def _on_array(self, topic: str, message: Detection2DArray) -> None:
        stamp = _stamp(message.header)
        entries = messages.array_to_sound_estimates(
            message, self.evaluation.sensor.cell_size_m)
        arrival = self._scorer.add_array(topic, stamp, entries, time.monotonic())
        if arrival is not Arrival.USED:
            self.counts['late'] += 1
            raise Malformed(
                arrival.value, f'the array of {in_seconds(stamp)} s is {arrival.value}')
        self._score()

    def _on_state(self, topic: str, message: Odometry) -> None:
        state = messages.odometry_to_estimate(message, 0.0)
        if self._scorer.add_state(topic, _stamp(message.header), state) is Arrival.USED:
            self._score()

    def _on_frame(self, image: Image) -> None:
        """Keep a frame for the report, and when it arrived."""
        if self.active:
            now_s = time.monotonic()
            self._scorer.add_frame(_stamp(image.header), image_to_array(image), now_s)

    def _on_cells(self, image: Image, where: FrameMap | None) -> None:
        """Keep the cells of a conditioned frame for the report."""
        if self.active and where is not None:
            self._scorer.scene.add_cells(_stamp(image.header), image_to_array(image), where)

    def _on_statistic(self, name: str, image: Image) -> None:
        """Keep the statistic of a chain for the report."""
        if self.active:
            self._scorer.scene.add_statistic(name, _stamp(image.header), image_to_array(image))

    def _on_timer(self) -> None:
        if self._scorer.scene.full and self._pictures:
            # Each reader of large frames costs their writers, too.  Maps are small: a conditioner
            # that is started again waits for all their readers.
            self.leave(*self._pictures)
            self._pictures = []
        self._take_waiting()
        now_s = time.monotonic()
        while self._restarted and now_s - self._restarted[0][0] > _CAUGHT_UP_S:
            restarted_s, node = self._restarted.popleft()
            self._scorer.expect_no_more(node, restarted_s)
        self._score(now_s - self.run.answer_within_s)
        if self.active:
            self._flush()

    def _take_waiting(self) -> None:
        """Take what waits in the queues: a node that stood still misses none of it."""
        for each in self.inputs:
            each.drain()

    def _on_restart(self, message: DiagnosticArray) -> None:
        """
        Expect no answer of a restarted node to frames from before its new process started.

        It received the later ones of those that came while it was starting, and may yet answer
        them.
        """
        restarted, now_s = run_records.NodeRestarted.from_message(message), time.monotonic()
        self._scorer.expect_no_more(restarted.node, now_s - restarted.started_s_ago)
        self._restarted.append((now_s, restarted.node))
        self._score()

    def _flush(self) -> None:
        fault = self._scorer.flush()
        self.broken = str(fault or '')

    def _score(self, older_than_s: float = -float('inf')) -> None:
        """Score and announce the frames that are complete, or older than a time [s]."""
        for scored in self._scorer.score(older_than_s):
            self.counts['in'] = scored.number
            chains = tuple(
                run_records.ChainCounts(name, len(each.detections or ()), len(each.tracks or ()))
                for name, each in scored.answers.items())
            message = run_records.FrameScored(scored.stamp, scored.number, chains).to_message()
            self._scored.publish(message)
            self.bringup.tell(run_records.SCORED, message)
            self.counts['out'] += 1


def _stamp(header: Header) -> int:
    """Return a stamp [ns] that a message can carry on, or raise Malformed."""
    stamp = messages.stamp_key(header.stamp)
    if not 0 <= stamp < _LATEST_NS:
        raise Malformed('not a stamp', f'the stamp is {in_seconds(stamp)} s')
    return stamp


def main(args: list[str] | None = None) -> None:
    """Entry point of ``ros2 run lowsnr_eval evaluator_node``."""
    run(EvaluatorNode, args)


if __name__ == '__main__':
    main()
