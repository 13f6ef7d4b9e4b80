"""Scoring of a run from its messages, whether they come from nodes or from a bag."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Truth
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.scoring.frame_join import Assembly
from lowsnr_eval.scoring.frame_join import Frame
from lowsnr_eval.scoring.frame_scoring import Answer
from lowsnr_eval.scoring.results import ResultsWriter
from lowsnr_eval.scoring.results import summarize
from lowsnr_eval.scoring.resumption import resume
from lowsnr_eval.scoring.resumption import Resumed
from lowsnr_eval.scoring.scene import SceneWriter
from lowsnr_eval.scoring.tallies import Scoreboard

TRUTH = 'ground_truth'


@dataclass(frozen=True)
class Judged:
    """A scored frame: its stamp [ns], its number and what each chain answered."""

    stamp: int
    number: int
    answers: dict[str, Answer]


class Judge:
    """
    Scores the frames of a run and writes its results; use it in ``with``.

    ``topics`` are those whose arrays and states it must be given.  Without truth a frame is
    known by the first chain's answer, and what was declared is counted alone.

    Parameters
    ----------
    run, evaluation
        What is scored, how, and the folder for it, which is made.
    seed
        Root seed of the run.
    refuse
        Called with a line for each frame that cannot be scored.
    resumed
        Whether it goes on from what an earlier life of it left in the folder.

    Raises
    ------
    ValueError
        One line, if the folder holds earlier results or cannot be written to.

    """

    def __init__(
        self, run: RunSettings, evaluation: Evaluation, seed: int, refuse: Callable[[str], None],
        resumed: bool = False,
    ) -> None:
        self._run, self._seed, self._refuse = run, seed, refuse
        space = '{}/' if run.namespaces else ''
        self._chains = {
            name: (f'{space.format(name)}detections', f'{space.format(name)}tracks')
            for name in run.detectors}
        answers = [topic for pair in self._chains.values() for topic in pair]
        self.topics = [TRUTH, *answers] if run.truth else answers
        self._key = self.topics[0]
        folder = Path(run.results)
        folder.mkdir(parents=True, exist_ok=True)
        self._board = Scoreboard(evaluation, run.detectors)
        before = resume(folder, self._board) if resumed else Resumed()
        self._writer = ResultsWriter(folder, before.ends)
        self._scene = SceneWriter(folder, evaluation.sensor.cell_size_m, resumed)
        self._assembly = Assembly(self.topics, self._key, before.stamp)
        self.see = self._scene.see
        self.published = self.number = before.number

    def __enter__(self) -> Judge:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._writer.close()
        self._scene.close()

    @property
    def shows_all(self) -> bool:
        """Whether frames are still taken for the report."""
        return not self._scene.full

    def add_array(self, topic: str, stamp: int, entries: list[Estimate], now_s: float) -> bool:
        """Take an array; False if its frame is done already or the array is a second one."""
        taken = self._assembly.add_array(topic, stamp, entries, now_s)
        self.published += taken and topic == self._key
        return taken

    def add_state(self, topic: str, stamp: int, state: Estimate) -> bool:
        """Take an odometry of a topic; False if its frame is done already."""
        return self._assembly.add_state(topic, stamp, state)

    def score(self, older_than_s: float = -float('inf')) -> list[Judged]:
        """Score the frames that are whole, or have waited since ``older_than_s``."""
        return [judged for frame in self._assembly.take(older_than_s)
                if (judged := self._score_one(frame)) is not None]

    def expect_no_more(self, node: str, before_s: float) -> None:
        """Expect no answer of a node (its full name) to frames that came before a time [s]."""
        space, _, name = node.strip('/').rpartition('/')
        for chain, topics in self._chains.items():
            if space in ('', chain) and name == f'{chain}_detector':
                self._assembly.expect_no_more(topics, before_s)
            elif name == 'tracker' and space in ('', chain):
                self._assembly.expect_no_more(topics[1:], before_s)

    def settle(self, checkpoint: bool = True) -> str:
        """
        Have all on disk that was scored, and the summary; say what is wrong with that.

        With a ``checkpoint`` a restart has less to read again.
        """
        trouble = self._writer.settle()
        try:
            self.write_summary()
            if checkpoint:
                self._writer.write_checkpoint({'board': self._board.state()})
        except OSError as error:
            trouble = trouble or f'{self._run.results}: {error.strerror}'
        return trouble

    def write_summary(self) -> None:
        """Write ``summary.json`` of the frames so far."""
        summary = summarize(
            self._board, scenario=self._run.scenario, seed=self._seed, published=self.published)
        for name, point in zip(self._run.detectors, self._run.operating_points):
            summary['detectors'][name]['operating_point'] = point
        self._writer.write_summary(summary)

    def flush(self) -> None:
        """Write what was said of frames that are not seen."""
        self._scene.flush()

    def _score_one(self, frame: Frame) -> Judged | None:
        truth = frame.answer(TRUTH) if self._run.truth else None
        if truth is None and self._run.truth:
            self._refuse(f'answers to stamp {frame.stamp / 1e9:.9g} s, of which no truth came')
            return None
        self.number += 1
        answers = {name: self._answer(frame, *topics) for name, topics in self._chains.items()}
        objects = None if truth is None else [Truth(item.id, item.state) for item in truth]
        scores = self._board.score_frame(self.number, frame.stamp / 1e9, objects, answers)
        self._writer.add_scores(scores)
        self._scene.say(self.number, frame.stamp, objects or (), answers)
        for name, answer in answers.items():
            if answer.latency_ms is not None:
                self._writer.add_latency(self.number, name, answer)
        return Judged(frame.stamp, self.number, answers)

    def _answer(self, frame: Frame, detections: str, tracks: str) -> Answer:
        sent = frame.arrived.get(self._key)
        arrived = [frame.arrived.get(topic) for topic in (tracks, detections)]
        latencies = [None if sent is None or at is None else 1e3 * (at - sent) for at in arrived]
        return Answer(frame.answer(detections), frame.answer(tracks), *latencies)
