"""The evaluator node: scores what every chain answered against the truth."""

from __future__ import annotations

from collections import deque
from functools import partial
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue
from lowsnr_common.ros import messages
from lowsnr_common.ros.managed_node import ManagedNode
from lowsnr_common.ros.managed_node import run
from lowsnr_common.ros.parameters import declare
from lowsnr_common.ros.qos import any_reliability
from lowsnr_common.ros.qos import reliable
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.scoring.run_scoring import Judge
from lowsnr_eval.scoring.run_scoring import Judged
from lowsnr_eval.scoring.scene import WAITING
from nav_msgs.msg import Odometry
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn
import scipy.optimize  # noqa: F401  (here, lest the first frame wait for it)
from sensor_msgs.msg import Image
from vision_msgs.msg import Detection2DArray

_SUMMARY_EVERY_S = 1.0
_CHECKPOINT_EVERY = 5  # summaries
# What a node that is back heard while it was starting, it has answered after this time.
_CAUGHT_UP_S, _MOST_BACK = 1.0, 100


class EvaluatorNode(ManagedNode):
    """Score each frame once every chain has answered it; say so on ``scored``."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('evaluator', **kwargs)
        self.run = declare(self, RunSettings)
        self.evaluation = declare(self, Evaluation)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the results and subscribe to truth and answers."""
        self._judge = Judge(
            self.run, self.evaluation, self.settings.seed, self.refuse,
            resumed=self.settings.lives > 0)
        depth = reliable(self.settings.queue_depth)
        self._rounds = 0
        self._back: deque[tuple[float, str]] = deque(maxlen=_MOST_BACK)
        self._scored = self.create_publisher(DiagnosticArray, 'scored', depth)
        self.outputs = {self._scored: self.settings.consumers}
        for topic in self._judge.topics:
            states = self.listen(
                Odometry, f'{topic}/odometry', partial(self._on_state, topic), depth,
                steady=False)
            self.listen(
                Detection2DArray, topic, partial(self._on_array, topic), depth, first=states)
        self.listen(Image, 'image_raw', self._on_frame, any_reliability(WAITING))
        self.listen(
            DiagnosticArray, 'restarts', self._on_restart, depth, needed=False, steady=False)
        self.create_timer(_SUMMARY_EVERY_S, self._on_timer)
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Score what has come and write the summary."""
        self._score(time.monotonic())
        self._judge.flush()
        self._settle()
        return super().on_deactivate(state)

    def destroy_node(self) -> None:
        """Leave a summary of all that was scored, whatever ends the node."""
        if judge := self.__dict__.pop('_judge', None):
            with judge:
                judge.settle()
        super().destroy_node()

    def _on_array(self, topic: str, message: Detection2DArray) -> None:
        entries = messages.array_to_sound_estimates(
            message, self.evaluation.sensor.cell_size_m)
        stamp = messages.stamp_key(message.header.stamp)
        if self._judge.add_array(topic, stamp, entries, time.monotonic()):
            self._score()
        else:
            self.counts['late'] += 1
            self.refuse(f'{topic}: a second or late array for stamp {stamp / 1e9:.9g} s')

    def _on_state(self, topic: str, message: Odometry) -> None:
        state = messages.odometry_to_estimate(message, 0.0)
        if self._judge.add_state(topic, messages.stamp_key(message.header.stamp), state):
            self._score()

    def _on_frame(self, image: Image) -> None:
        """Keep a frame for the report; only what is shown there depends on it."""
        if self.active and self._judge.shows_all:
            frame = messages.image_to_frame(image)
            self._judge.see(messages.stamp_key(image.header.stamp), frame)

    def _on_timer(self) -> None:
        now_s = time.monotonic()
        while self._back and now_s - self._back[0][0] > _CAUGHT_UP_S:
            back_s, node = self._back.popleft()
            self._judge.expect_no_more(node, back_s)
        self._score(now_s - self.run.answer_within_s)
        if self.active:
            self._settle()

    def _on_restart(self, message: DiagnosticArray) -> None:
        """
        Expect nothing of a node that was started again to what came before it was.

        Of what came while it was starting it has heard the later part: that it may yet answer.
        """
        now_s = time.monotonic()
        for status in message.status:
            since = {item.key: item.value for item in status.values}.get('started_s_ago', '0')
            self._judge.expect_no_more(status.name, now_s - float(since))
            self._back.append((now_s, status.name))
        self._score()

    def _settle(self) -> None:
        self._rounds += 1
        trouble = self._judge.settle(self._rounds % _CHECKPOINT_EVERY == 0)
        self.broken = trouble and f'{trouble}; scores are kept until they can be written'

    def _score(self, older_than_s: float = -float('inf')) -> None:
        """Score the frames that are whole, or have waited since ``older_than_s``."""
        for judged in self._judge.score(older_than_s):
            self.counts['in'] = judged.number
            self._say_scored(judged)

    def _say_scored(self, judged: Judged) -> None:
        message = DiagnosticArray()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(
            judged.stamp, 1_000_000_000)
        for name, answer in judged.answers.items():
            counts = {
                'frame': judged.number, 'detections': len(answer.detections or ()),
                'tracks': len(answer.tracks or ())}
            message.status.append(DiagnosticStatus(
                name=name, values=[KeyValue(key=k, value=str(v)) for k, v in counts.items()]))
        self._scored.publish(message)
        self.counts['out'] += 1


def main(args: list[str] | None = None) -> None:
    """Entry point of ``ros2 run lowsnr_eval evaluator_node``."""
    run(EvaluatorNode, args)


if __name__ == '__main__':
    main()
