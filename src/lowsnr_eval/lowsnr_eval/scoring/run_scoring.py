# SPDX-License-Identifier: Apache-2.0
"""Scoring of a run from its messages, whether they arrive at a node or come from a bag."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from lowsnr_bringup.run.frame_ledger import FrameLedger
from lowsnr_bringup.run.growing_file import WriteFault
from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Truth
from lowsnr_common.core.timeline import in_seconds
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.scene.scene_writer import SceneWriter
from lowsnr_eval.scene.scene_writer import WAITING
from lowsnr_eval.scoring.camera_table import camera_line
from lowsnr_eval.scoring.camera_table import open_camera_table
from lowsnr_eval.scoring.entry_tables import EntryTables
from lowsnr_eval.scoring.frame_join import Arrival
from lowsnr_eval.scoring.frame_join import Frame
from lowsnr_eval.scoring.frame_join import FrameJoin
from lowsnr_eval.scoring.frame_scoring import Answer
from lowsnr_eval.scoring.frame_scoring import score_frame
from lowsnr_eval.scoring.score_tables import ScoreTables
import numpy as np

TRUTH, STATISTIC = 'ground_truth', 'statistic'
NO_TRUTH = 'no truth'
# Frames whose arrival is known while their answers are not.
_MOST_UNANSWERED = 1000


@dataclass(frozen=True)
class ScoredFrame:
    """A scored frame: its stamp [ns], its number from 1, and what each chain answered."""

    stamp: int
    number: int
    answers: dict[str, Answer]


class RunScorer:
    """
    Scores the frames of a run and writes its tables; :meth:`close` it at the end.

    ``topics`` are those of the arrays and states that it needs, ``statistics`` those of the
    statistics that its scene takes, with the names of their chains.  Without truth the first
    chain's detections show that a frame exists, and what was declared is counted, nothing else.
    Latencies are the times from the arrival of the truth, or else of the frame, which is one of
    those that the scene shows; they are not known of others.
    ``ledger`` counts the frames that are known to exist and where they went, ``number`` is that
    of the last one scored.  ``tables``, ``entries`` and ``scene`` are the writers of its results;
    the scene takes the frames too.

    Parameters
    ----------
    run, evaluation
        What is scored, how, and the folder for the results, which is made.
    reject
        Called with a sentence and a reason code for each frame that cannot be scored.
    resumed
        Whether to continue the results that an earlier process left in the folder.
    conditioned
        Whether frames are conditioned: there are maps of them, and the scene is given their
        cells too.

    Raises
    ------
    ValueError
        One line, if the folder holds earlier results or cannot be written to.

    """

    def __init__(
        self, run: RunSettings, evaluation: Evaluation, reject: Callable[[str, str], None],
        resumed: bool = False, conditioned: bool = False,
    ) -> None:
        self._truth, self._evaluation, self._reject = run.truth, evaluation, reject
        space = '{}/' if run.namespaces else ''
        self._chains = {
            name: (f'{space.format(name)}detections', f'{space.format(name)}tracks')
            for name in run.detectors}
        self.statistics = {
            f'{space.format(name)}{STATISTIC}': name for name in run.statistic_maps}
        answers = [topic for pair in self._chains.values() for topic in pair]
        self.topics = [TRUTH, *answers] if run.truth else answers
        self._key = self.topics[0]
        self._lags = dict(zip(run.detectors, run.lags))
        self._arrived_s: dict[int, float] = {}  # of frames, by stamp
        folder = Path(run.results)
        folder.mkdir(parents=True, exist_ok=True)
        self.tables = ScoreTables(folder, run.detectors, resumed)
        cell_size_m = evaluation.sensor.cell_size_m
        self.entries = EntryTables(folder, cell_size_m, self.tables.number if resumed else None)
        self._camera = open_camera_table(folder, resumed) if conditioned else None
        self.scene = SceneWriter(
            folder, cell_size_m, resumed, conditioned, WAITING + run.longest_lag,
            run.statistic_maps)
        self._join = FrameJoin(self.topics, self._key, self.tables.stamp_ns, run.longest_lag)
        self.number = self.tables.number
        self.ledger = FrameLedger(self.number)

    def add_frame(self, stamp: int, frame: np.ndarray, now_s: float) -> None:
        """Add a frame (rows, cols) with its stamp [ns] and the wall time of its arrival [s]."""
        self._arrived_s[stamp] = now_s
        if len(self._arrived_s) > _MOST_UNANSWERED:
            del self._arrived_s[next(iter(self._arrived_s))]
        self.scene.add_frame(stamp, frame)

    def add_map(self, stamp: int, where: FrameMap) -> None:
        """Add the map of the frame with a stamp [ns]."""
        if self._camera:
            self._camera.append(camera_line(stamp, where))

    def add_array(self, topic: str, stamp: int, entries: list[Estimate], now_s: float) -> Arrival:
        """Add an array with its stamp [ns] and the wall time of its arrival [s]."""
        arrival = self._join.add_array(topic, stamp, entries, now_s)
        if arrival is Arrival.USED and topic == self._key:
            self.ledger.publish(stamp)
        return arrival

    def add_state(self, topic: str, stamp: int, state: Estimate) -> Arrival:
        """Add an odometry of a topic with its stamp [ns]."""
        return self._join.add_state(topic, stamp, state)

    def score(self, older_than_s: float = -float('inf')) -> list[ScoredFrame]:
        """Score the frames that are complete, or have waited since ``older_than_s`` [s]."""
        return [scored for frame in self._join.take(older_than_s)
                if (scored := self._score_one(frame)) is not None]

    def expect_no_more(self, node: str, before_s: float) -> None:
        """Expect no answer of a node (its full name) to frames from before a time [s]."""
        space, _, name = node.strip('/').rpartition('/')
        for chain, topics in self._chains.items():
            # A detector with a lag still answers frames that the conditioner passed on before.
            first = name == f'{chain}_detector' or (
                name == 'conditioner' and not self._lags.get(chain))
            if space in ('', chain) and first:
                self._join.expect_no_more(topics, before_s)
            elif name == 'tracker' and space in ('', chain):
                detections, tracks = topics
                self._join.expect_no_more((tracks,), before_s, detections)

    def end_frames(self) -> None:
        """Expect no more frames: answers wait for none any more."""
        self._join.end_frames()

    def flush(self) -> WriteFault | None:
        """Write what waits; where the tables have no room, the scene gives way to them."""
        fault = self._flush_tables()
        if fault and fault.full:
            self.scene.give_way()
            fault = self._flush_tables()
        return fault

    def _flush_tables(self) -> WriteFault | None:
        return self.tables.flush() or self.entries.flush() or (
            self._camera.flush() if self._camera else None)

    def close(self) -> None:
        """Write what waits, of all things the scores, and close the files."""
        self.flush()
        if self.tables.flush():
            self.entries.give_way()
        self.tables.close()
        self.entries.close()
        if self._camera:
            self._camera.close()
        self.scene.close()

    def _score_one(self, frame: Frame) -> ScoredFrame | None:
        if self._key not in frame.arrays:  # only its answers show that it exists
            self.ledger.publish(frame.stamp)
        truth = frame.answer(TRUTH) if self._truth else None
        if truth is None and self._truth:
            self._reject(
                f'the truth of the frame of {in_seconds(frame.stamp)} s did not arrive', NO_TRUTH)
            return None
        self.number += 1
        sent = frame.arrived_s.get(TRUTH, self._arrived_s.pop(frame.stamp, None))
        answers = {
            name: self._answer(frame, sent, *topics) for name, topics in self._chains.items()}
        objects = None if truth is None else [Truth(item.id, item.state) for item in truth]
        scores = score_frame(
            self.number, frame.stamp / 1e9, objects, answers, self._evaluation)
        # The lines of the scores come last: they show a process that continues what is whole.
        self.entries.add(self.number, frame.stamp, answers, objects or ())
        self.tables.add(scores, answers)
        self.scene.add_answers(self.number, frame.stamp, objects, answers)
        self.ledger.score(frame.stamp, self.number)
        return ScoredFrame(frame.stamp, self.number, answers)

    def _answer(
        self, frame: Frame, sent: float | None, detections: str, tracks: str,
    ) -> Answer:
        """Return what a chain answered to a frame that was sent at a time [s], None if unknown."""
        arrived = [frame.arrived_s.get(topic) for topic in (tracks, detections)]
        latencies = [None if sent is None or at is None else 1e3 * (at - sent) for at in arrived]
        return Answer(frame.answer(detections), frame.answer(tracks), *latencies)
