"""The evaluator node: scores what every chain answered against the truth."""

from __future__ import annotations

from functools import partial
from pathlib import Path
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue
from lowsnr_eval.assembly import Assembly
from lowsnr_eval.assembly import Frame
from lowsnr_eval.results import ResultsWriter
from lowsnr_eval.results import summarize
from lowsnr_eval.run_settings import RunSettings
from lowsnr_eval.scoreboard import Scoreboard
from lowsnr_eval.scoring import Answer
from lowsnr_eval.scoring import Evaluation
from lowsnr_sensor.records import Truth
from lowsnr_sensor.ros import messages
from lowsnr_sensor.ros.params import declare
from lowsnr_sensor.ros.runtime import ManagedNode
from lowsnr_sensor.ros.runtime import reliable
from lowsnr_sensor.ros.runtime import run
from nav_msgs.msg import Odometry
from rclpy.lifecycle import LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn
from vision_msgs.msg import Detection2DArray

TRUTH = 'ground_truth'
_SUMMARY_EVERY_S = 1.0


class EvaluatorNode(ManagedNode):
    """Score each frame once every chain has answered it; say so on ``scored``."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('evaluator', **kwargs)
        self.run = declare(self, RunSettings)
        self.evaluation = declare(self, Evaluation)
        space = '{}/' if self.run.namespaces else ''
        self._topics = {
            name: (f'{space.format(name)}detections', f'{space.format(name)}tracks')
            for name in self.run.detectors}

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the results and subscribe to truth and answers."""
        folder = Path(self.run.results)
        folder.mkdir(parents=True, exist_ok=True)
        self._writer = ResultsWriter(folder)
        self._board = Scoreboard(self.evaluation, self.run.detectors)
        topics = [TRUTH, *(topic for pair in self._topics.values() for topic in pair)]
        self._assembly = Assembly(topics, TRUTH)
        self._published = self._number = 0
        depth = reliable(self.settings.queue_depth)
        self._scored = self.create_publisher(DiagnosticArray, 'scored', depth)
        self.outputs = {self._scored: self.settings.consumers}
        for topic in topics:
            self.listen(
                Odometry, f'{topic}/odometry', partial(self._on_state, topic), depth)
            self.listen(
                Detection2DArray, topic, partial(self._on_array, topic), depth)
        self.create_timer(_SUMMARY_EVERY_S, self._on_timer)
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Score what has come and write the summary."""
        self._score(time.monotonic())
        self._write_summary()
        return super().on_deactivate(state)

    def _on_array(self, topic: str, message: Detection2DArray) -> None:
        entries = messages.array_to_estimates(message, self.evaluation.sensor.cell_size_m)
        stamp = messages.stamp_key(message.header.stamp)
        if self._assembly.add_array(topic, stamp, entries, time.monotonic()):
            self._published += topic == TRUTH
            self._score()
        else:
            self.counts['late'] += 1
            self.refuse(f'{topic}: a second or late array for stamp {stamp / 1e9:.9g} s')

    def _on_state(self, topic: str, message: Odometry) -> None:
        state = messages.odometry_to_estimate(message, 0.0)
        if self._assembly.add_state(topic, messages.stamp_key(message.header.stamp), state):
            self._score()

    def _on_timer(self) -> None:
        self._score(time.monotonic() - self.run.answer_within_s)
        if self.active:
            self._write_summary()

    def _score(self, older_than_s: float = -float('inf')) -> None:
        """Score the frames that are whole, or have waited since ``older_than_s``."""
        for frame in self._assembly.take(older_than_s):
            truth = frame.answer(TRUTH)
            if truth is None:
                self.refuse(f'answers to stamp {frame.stamp / 1e9:.9g} s, of which no truth came')
                continue
            self._number += 1
            answers = {name: self._answer(frame, name) for name in self.run.detectors}
            scores = self._board.score_frame(
                self._number, frame.stamp / 1e9, [Truth(t.id, t.state) for t in truth], answers)
            self._writer.add_scores(scores)
            for name, answer in answers.items():
                if answer.latency_ms is not None:
                    self._writer.add_latency(self._number, name, answer.latency_ms)
            self.counts['in'] = self._number
            self._say_scored(frame, answers)

    def _answer(self, frame: Frame, name: str) -> Answer:
        detections, tracks = (frame.answer(topic) for topic in self._topics[name])
        arrived = frame.arrived.get(self._topics[name][1])
        latency = None if arrived is None else 1e3 * (arrived - frame.arrived[TRUTH])
        return Answer(detections, tracks, latency)

    def _say_scored(self, frame: Frame, answers: dict[str, Answer]) -> None:
        message = DiagnosticArray()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(
            frame.stamp, 1_000_000_000)
        for name, answer in answers.items():
            counts = {
                'frame': self._number, 'detections': len(answer.detections or ()),
                'tracks': len(answer.tracks or ())}
            message.status.append(DiagnosticStatus(
                name=name, values=[KeyValue(key=k, value=str(v)) for k, v in counts.items()]))
        self._scored.publish(message)
        self.counts['out'] += 1

    def _write_summary(self) -> None:
        summary = summarize(
            self._board, scenario=self.run.scenario, seed=self.settings.seed,
            published=self._published)
        for name, point in zip(self.run.detectors, self.run.operating_points):
            summary['detectors'][name]['operating_point'] = point
        self._writer.write_summary(summary)


def main(args: list[str] | None = None) -> None:
    """Entry point of ``ros2 run lowsnr_eval evaluator_node``."""
    run(EvaluatorNode, args)


if __name__ == '__main__':
    main()
