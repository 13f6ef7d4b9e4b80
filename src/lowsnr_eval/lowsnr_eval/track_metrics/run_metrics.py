# SPDX-License-Identifier: Apache-2.0
"""The metrics of the tracks of a run, from its tables, frame by frame."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
import json
from pathlib import Path
from typing import Any

from lowsnr_bringup.plan.graph import build
from lowsnr_bringup.run import results_folder as files
from lowsnr_bringup.run.progress import progress
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.text import one_line
from lowsnr_eval.scoring.entry_tables import Entry
from lowsnr_eval.scoring.entry_tables import FrameRows
from lowsnr_eval.scoring.entry_tables import TRUTH_COLUMNS
from lowsnr_eval.scoring.final_summary import write_summary
from lowsnr_eval.scoring.frame_scoring import FrameScore
from lowsnr_eval.scoring.frame_scoring import LEVELS
from lowsnr_eval.scoring.score_tables import read_frames
from lowsnr_eval.track_metrics.chain_metrics import ChainMetrics
from lowsnr_eval.track_metrics.track_frame import TrackFrame
import numpy as np

# Metrics that take less time show no progress [s].
_DELAY_S = 1.0


class RunMetrics:
    """
    The metrics of the tracks of all chains of a run.

    A frame counts for a chain if its truth is known and the chain answered it.  A chain has no
    metrics if the tables do not hold as many objects and tracks of each such frame as were scored:
    a disk that was full took lines from them, and always from the frames with most objects.

    Parameters
    ----------
    folder
        Results folder; its tables are read line by line.
    detectors
        Names of the chains.
    evaluation
        Gate, cutoff and size of a cell.

    """

    def __init__(self, folder: Path, detectors: Sequence[str], evaluation: Evaluation) -> None:
        self._cell_size_m = evaluation.sensor.cell_size_m
        self._chains = {name: ChainMetrics(evaluation) for name in detectors}
        self._incomplete: set[str] = set()
        self._truth = FrameRows(folder / files.TRUTH_FILE, TRUTH_COLUMNS)
        self._tracks = FrameRows(folder / files.TRACKS_FILE)

    def add(self, scores: Sequence[FrameScore]) -> None:
        """Add the frame of these scores; frames come in order."""
        objects = self._truth.take(scores[0].frame)
        tracks: dict[str, list[Entry]] = {}
        for row in self._tracks.take(scores[0].frame):
            tracks.setdefault(row.detector, []).append(row)
        for score in scores:
            if score.level != LEVELS[1] or score.comparison is None or score.object_ids is None:
                continue
            own = tracks.get(score.detector, [])
            if (len(objects), len(own)) != (len(score.object_ids), score.comparison.declared):
                self._incomplete.add(score.detector)
            elif score.detector not in self._incomplete:
                self._chains[score.detector].add(self._frame(score.stamp_s, objects, own))

    def _frame(
        self, stamp_s: float, objects: Sequence[Entry], tracks: Sequence[Entry],
    ) -> TrackFrame:
        places = [np.reshape([row.values[:2] for row in some], (-1, 2)) * self._cell_size_m
                  for some in (objects, tracks)]
        existence = np.array([row.values[-1] for row in tracks])
        return TrackFrame(
            stamp_s, _names(objects), places[0], _names(tracks), places[1], existence)

    def figures(self, detector: str) -> dict[str, Any] | None:
        """Return the metrics of a chain; None where no frame counts, or the tables lack lines."""
        return None if detector in self._incomplete else self._chains[detector].figures()


def add_track_metrics(folder: Path) -> list[str]:
    """
    Add the metrics of tracks to the summary of a results folder.

    Results without ``truth.csv`` have none.  The summary is whole without them: where they cannot
    be computed or written it stays as it is, and a line that is returned says why.
    """
    try:
        summary = json.loads((folder / files.SUMMARY_FILE).read_text('utf-8'))
        if (folder / files.TRUTH_FILE).is_file():
            _add(folder, summary)
            write_summary(folder, summary)
    except (OSError, ValueError) as error:
        return [f'no metrics of tracks: {one_line(error)}']
    return []


def _add(folder: Path, summary: dict[str, Any]) -> None:
    chains = summary['detectors']
    metrics = RunMetrics(
        folder, [*chains], build(Evaluation, summary['evaluation'], str(folder)))
    frames = summary['frames']['scored'] + summary['frames']['unanswered']
    with progress('metrics of tracks', frames, 'frames', delay_s=_DELAY_S, leave=False) as advance:
        for scores in read_frames(folder / files.FRAMES_FILE, [*chains]):
            metrics.add(scores)
            advance(1)
    for name, figures in chains.items():
        figures['track_metrics'] = metrics.figures(name)


def _names(rows: Sequence[Entry]) -> list[str]:
    """Return the names of rows, those without one by their order; no two are alike."""
    seen: Counter[str] = Counter()
    names = []
    for row in rows:
        seen[row.name] += 1
        # An escaped name has no space.
        names.append(f'{row.name} {seen[row.name]}' if seen[row.name] > 1 else row.name)
    return names
