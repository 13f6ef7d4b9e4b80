"""
Scoring of a run: the figures of every chain, for detections and for tracks.

A chain is a detector with the tracker that follows it.  :class:`Scoreboard` is told of each
frame once, with what every chain answered; it returns the scores of that frame, and at any
time the figures of all frames so far.
"""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from typing import Any

from lowsnr_common.core.records import Truth
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_eval.scoring.frame_scoring import Answer
from lowsnr_eval.scoring.frame_scoring import compare
from lowsnr_eval.scoring.frame_scoring import FrameScore
from lowsnr_eval.scoring.metrics import ratio
from lowsnr_eval.scoring.metrics import RootMeanSquare
from lowsnr_eval.scoring.metrics import wilson_interval
from lowsnr_eval.scoring.stream_quantiles import Sample
import numpy as np

LEVELS = ('detection', 'tracking')
_NEED_TRUTH = (
    'frames_with_object', 'frames_without_object', 'objects_present', 'hits', 'frames_false',
    'false_alarms', 'appearances', 'appearances_hit')


class Scoreboard:
    """
    The scores of all chains of a run.

    Parameters
    ----------
    evaluation
        Gate and cutoff.
    detectors
        Names of the chains.

    """

    def __init__(self, evaluation: Evaluation, detectors: Sequence[str]) -> None:
        self.evaluation = evaluation
        self.chains = len(detectors)
        self.frames = 0
        self.unanswered = 0
        self.stamp_s = 0.0
        self._tallies = {name: {level: _Tally() for level in LEVELS} for name in detectors}
        self._latencies_ms = {name: (Sample(), Sample()) for name in detectors}

    def score_frame(
        self, frame: int, stamp_s: float, truth: Sequence[Truth] | None,
        answers: Mapping[str, Answer],
    ) -> list[FrameScore]:
        """
        Score one frame; frames come in order.

        Parameters
        ----------
        frame
            Number k of the frame.
        stamp_s
            Its time [s].
        truth
            Objects present in it, None where that is not known.
        answers
            The answer of each chain by the name of its detector; none for a silent one.

        Returns
        -------
        list of FrameScore
            One for each chain and level, in the order of the chains.

        """
        objects = None if truth is None else tuple(item.id for item in truth)
        scores = []
        for name in self._tallies:
            answer = answers.get(name, Answer())
            self.add_times(name, answer)
            for level, estimates in zip(LEVELS, (answer.detections, answer.tracks)):
                outcome = None
                if estimates is not None:
                    outcome = compare(truth, estimates, self.evaluation)
                scores.append(FrameScore(frame, stamp_s, name, level, objects, outcome))
        self.replay(scores)
        return scores

    def replay(self, scores: Sequence[FrameScore]) -> None:
        """Count the scores of one frame."""
        for score in scores:
            self._tallies[score.detector][score.level].add(score)
            self.stamp_s = score.stamp_s
        self.frames += 1
        self.unanswered += any(score.outcome is None for score in scores)

    def add_times(self, detector: str, answer: Answer) -> None:
        """Count how long a chain took to answer."""
        for times, each in zip(
                self._latencies_ms[detector], (answer.latency_ms, answer.detection_ms)):
            if each is not None:
                times.add(each)

    def state(self) -> dict[str, Any]:
        """Return all that was counted, as JSON has it."""
        return {
            'frames': self.frames, 'unanswered': self.unanswered, 'stamp_s': self.stamp_s,
            'tallies': {name: {level: tally.state() for level, tally in tallies.items()}
                        for name, tallies in self._tallies.items()},
            'latencies_ms': {name: [times.state() for times in pair]
                             for name, pair in self._latencies_ms.items()}}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over what :meth:`state` returned once; where that fails nothing is changed."""
        tallies = {name: {level: _Tally.of(found) for level, found in levels.items()}
                   for name, levels in state['tallies'].items()}
        latencies = {
            name: (Sample.of(pair[0]), Sample.of(pair[1]))
            for name, pair in state['latencies_ms'].items()}
        if not tallies.keys() == latencies.keys() == self._tallies.keys():
            raise ValueError('the checkpoint is that of other chains')
        frames, unanswered, stamp_s = (
            state['frames'], state['unanswered'], float(state['stamp_s']))
        self._tallies, self._latencies_ms = tallies, latencies
        self.frames, self.unanswered, self.stamp_s = frames, unanswered, stamp_s

    def figures(self) -> dict[str, dict[str, Any]]:
        """Return the figures of every chain so far; None for those that do not exist."""
        return {
            name: {level: tally.figures() for level, tally in tallies.items()}
            | {key: times.percentiles() for key, times in zip(
                ('latency_ms', 'detection_latency_ms'), self._latencies_ms[name])}
            for name, tallies in self._tallies.items()
        }


class _Tally:
    """The sums over all frames of one chain at one level."""

    def __init__(self) -> None:
        self._counts = dict.fromkeys((
            'unanswered', 'frames_without_truth', 'declared', *_NEED_TRUTH), 0)
        self._position, self._velocity = RootMeanSquare(), RootMeanSquare()
        self._gospa = RootMeanSquare()
        self._present: set[str] = set()
        self._not_yet_hit: dict[str, int] = {}
        self._frames_to_hit = 0

    @classmethod
    def of(cls, state: Mapping[str, Any]) -> _Tally:
        """Return the tally of which :meth:`state` was taken."""
        tally = cls()
        tally._counts |= state['counts']
        tally._position, tally._velocity, tally._gospa = (
            RootMeanSquare(*sums) for sums in state['sums'])
        tally._present, tally._not_yet_hit = set(state['present']), dict(state['not_yet_hit'])
        tally._frames_to_hit = state['frames_to_hit']
        return tally

    def state(self) -> dict[str, Any]:
        """Return the sums as JSON has them."""
        return {
            'counts': self._counts, 'present': sorted(self._present),
            'not_yet_hit': self._not_yet_hit, 'frames_to_hit': self._frames_to_hit,
            'sums': [(each.total, each.count)
                     for each in (self._position, self._velocity, self._gospa)]}

    def add(self, score: FrameScore) -> None:
        self._note_appearances(score)
        outcome, counts = score.outcome, self._counts
        if outcome is None:
            counts['unanswered'] += 1
            return
        counts['declared'] += outcome.declared
        if score.objects is None or outcome.false_alarms is None or outcome.gospa_m is None:
            counts['frames_without_truth'] += 1
            return
        if score.objects:
            counts['frames_with_object'] += 1
        else:
            counts['frames_without_object'] += 1
            counts['frames_false'] += outcome.declared > 0
        counts['objects_present'] += len(score.objects)
        counts['hits'] += len(outcome.hit)
        counts['false_alarms'] += outcome.false_alarms
        self._position.add(outcome.position_errors_m)
        self._velocity.add(outcome.velocity_errors_mps)
        self._gospa.add(np.array(outcome.gospa_m))

    def _note_appearances(self, score: FrameScore) -> None:
        """Count the frames from an object's appearance to its first hit."""
        present = set(score.objects or ())
        for name in present - self._present:
            self._not_yet_hit[name] = score.frame
            self._counts['appearances'] += 1
        self._present = present
        for name in score.outcome.hit if score.outcome else ():
            if name in self._not_yet_hit:
                self._frames_to_hit += score.frame - self._not_yet_hit.pop(name)
                self._counts['appearances_hit'] += 1

    def figures(self) -> dict[str, Any]:
        hits, objects = self._counts['hits'], self._counts['objects_present']
        false, empty = self._counts['frames_false'], self._counts['frames_without_object']
        counts: dict[str, int | None] = dict(self._counts)
        if self._counts['frames_without_truth'] and not empty + self._counts['frames_with_object']:
            counts |= dict.fromkeys(_NEED_TRUTH)
        return {
            'pd': ratio(hits, objects),
            'pd_interval': wilson_interval(hits, objects),
            'pfa_per_frame': ratio(false, empty),
            'pfa_interval': wilson_interval(false, empty),
            'first_detection_latency_frames': ratio(
                self._frames_to_hit, self._counts['appearances_hit']),
            'rmse_position_m': self._position.value,
            'rmse_velocity_mps': self._velocity.value,
            'gospa_m': self._gospa.value,
            **counts,
            'hits_with_velocity': self._velocity.count,
        }
