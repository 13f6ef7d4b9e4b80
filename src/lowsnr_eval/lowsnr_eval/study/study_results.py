# SPDX-License-Identifier: Apache-2.0
"""The results of a study: the scores of every chain over all its runs, and tables of them."""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping
from collections.abc import Sequence
import csv
from dataclasses import dataclass
from dataclasses import field
import json
from pathlib import Path
from typing import Any

from lowsnr_eval.study.experiment import BlockResults
from lowsnr_eval.study.run_scores import CURVES
from lowsnr_eval.study.run_scores import figures_of_merit
from lowsnr_eval.study.run_scores import frame_curves
from lowsnr_eval.study.run_scores import RunScores
from lowsnr_eval.study.study import EMPTY
from lowsnr_eval.study.study import OBJECT
from lowsnr_eval.study.study import POINTS
from lowsnr_eval.study.study import ROC_POINTS
from lowsnr_eval.study.study import Study
from lowsnr_eval.study.study import SWEEP
from lowsnr_eval.study.verdicts import claim_verdicts
from lowsnr_eval.study.verdicts import cost_verdict
from lowsnr_eval.study.verdicts import Key
import numpy as np

SCHEMA = 1


@dataclass
class StudyResults:
    """
    The scores of a study, or of the part of it that is finished.

    ``scores`` are by the name of the case, and then by label, operating point and level;
    ``times_s`` are CPU times of detector and tracker for a frame in each block, (blocks, 2)
    [s], by label and operating point.
    """

    study: Study
    scores: dict[str, dict[Key, RunScores]] = field(default_factory=dict)
    times_s: dict[tuple[str, str], np.ndarray] = field(default_factory=dict)

    def of(self, kind: str, snr_db: float) -> Mapping[Key, RunScores]:
        """Return the scores of a case; none if it did not run."""
        return self.scores.get(f'{kind}{snr_db:g}dB', {})

    @property
    def runs_done(self) -> int:
        """Return the number of runs that are finished at every SNR."""
        return min((max(map(len, self.of(OBJECT, snr).values()), default=0)
                    for snr in self.study.snrs_db), default=0)


def join_blocks(
    study: Study, blocks: Iterable[tuple[str, BlockResults | None]],
) -> StudyResults:
    """Join the blocks of a study: name and results in order, None if not finished."""
    parts: dict[str, dict[Key, list[RunScores]]] = {}
    times: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for name, results in blocks:
        case = parts.setdefault(name.rpartition('-')[0], {})
        for (label, point), result in (results or {}).items():
            case.setdefault((label, point, 'detection'), []).append(result.detection)
            if result.tracking is not None and len(result.tracking):
                case.setdefault((label, point, 'tracking'), []).append(result.tracking)
            if name.startswith(OBJECT) and point in POINTS:
                times.setdefault((label, point), []).append(
                    (result.detector_s, result.tracker_s))
    joined = {
        case: {key: RunScores.join(found) for key, found in by_key.items()}
        for case, by_key in parts.items()}
    return StudyResults(study, joined, {key: np.array(found) for key, found in times.items()})


def median_times(results: StudyResults) -> dict[str, tuple[float, float]]:
    """Return the median CPU time of detector and tracker of each chain for a frame [s]."""
    medians = {key: np.median(found, axis=0) for key, found in results.times_s.items()}
    return {f'{label}/{point}': (float(own), float(tracker))
            for (label, point), (own, tracker) in medians.items()}


def merit_rows(results: StudyResults) -> list[dict[str, Any]]:
    """Return the figures of merit of every chain, SNR and level, with those of empty runs."""
    rows = []
    for snr_db in results.study.snrs_db:
        quiet = results.of(EMPTY, snr_db)
        for (label, point, level), scores in results.of(OBJECT, snr_db).items():
            if point not in POINTS:
                continue
            row = {
                'detector': label, 'snr_db': snr_db, 'operating_point': point, 'level': level,
                **figures_of_merit(scores), 'runs': len(scores),
                'seed': results.study.options.seed}
            if (label, point, level) in quiet:
                empty = figures_of_merit(quiet[label, point, level])
                row['empty_runs'] = {
                    key: empty[key] for key in (
                        'pfa_per_frame', 'pfa_interval', 'false_alarms_per_frame')}
                row['empty_runs']['runs'] = len(quiet[label, point, level])
            rows.append(row)
    return rows


def claim_rows(results: StudyResults) -> list[dict[str, Any]]:
    """Return the verdicts on the claims of the example."""
    study = results.study
    return [row for snr_db in study.snrs_db for row in claim_verdicts(
        study.example.number, snr_db, results.of(OBJECT, snr_db), results.of(EMPTY, snr_db),
        POINTS, study.options.seed)]


def cost_rows(results: StudyResults) -> list[dict[str, Any]]:
    """Return the verdict on the claim on CPU time, which differs from run to run."""
    study = results.study
    return cost_verdict(
        results.times_s, POINTS, study.snrs_db[0], results.runs_done, study.options.seed)


def roc(
    results: StudyResults, snr_db: float, label: str, points: Sequence[str] = ROC_POINTS,
) -> list[tuple[float, ...]]:
    """
    Return P_FA per empty frame and P_D of detections, each with its interval.

    Returns
    -------
    list of tuple of float
        P_FA, its lower and upper bound, P_D, its lower and upper bound, at each of some operating
        points.

    """
    found, quiet = results.of(OBJECT, snr_db), results.of(EMPTY, snr_db)
    keys = [(label, point, 'detection') for point in points]
    curve = []
    for key in keys:
        if key in found and key in quiet:
            empty, merit = figures_of_merit(quiet[key]), figures_of_merit(found[key])
            curve.append((
                empty['pfa_per_frame'], *empty['pfa_interval'],
                merit['pd'], *merit['pd_interval']))
    return curve


def snr_curve(results: StudyResults, label: str, point: str) -> list[tuple[float, ...]]:
    """Return SNR, P_D of detections and its bounds, at the SNRs of the study and those beyond."""
    key, curve = (label, point, 'detection'), []
    for case in results.study.cases:
        scores = results.of(case.kind, case.snr_db)
        if case.kind in (OBJECT, SWEEP) and key in scores:
            merit = figures_of_merit(scores[key])
            curve.append((case.snr_db, merit['pd'], *merit['pd_interval']))
    return sorted(curve)


def write_curves(results: StudyResults, path: Path) -> None:
    """Write the figures of merit of every frame as CSV; a cell without data is empty."""
    with path.open('w', encoding='utf-8', newline='') as file:
        writer = csv.writer(file, lineterminator='\n')
        writer.writerow([
            'detector', 'snr_db', 'operating_point', 'level', 'frame', 'runs', 'declared',
            *(f'{name}{end}' for name in CURVES for end in ('', '_low', '_high'))])
        for snr_db in results.study.snrs_db:
            for (label, point, level), scores in results.of(OBJECT, snr_db).items():
                if point not in POINTS:
                    continue
                curves = frame_curves(scores)
                table = np.vstack([curves['declared'][0], *(curves[name] for name in CURVES)])
                for k, column in enumerate(table.T, start=1):
                    cells = ['' if np.isnan(value) else f'{value:.6g}' for value in column]
                    writer.writerow(
                        [label, f'{snr_db:g}', point, level, k, len(scores), *cells])


def summary(results: StudyResults, thresholds: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of ``summary.json``, which the study alone determines."""
    study = results.study
    return {
        'schema': SCHEMA, 'example': study.example.number, 'scenario': study.example.scenario,
        'seed': study.options.seed, 'runs': study.options.runs,
        'runs_done': results.runs_done, 'thresholds_nat': thresholds,
        'points': merit_rows(results), 'claims': claim_rows(results)}


def write_json(content: Mapping[str, Any], path: Path) -> None:
    """Write a JSON file; a reader sees the whole of the old or of the new content."""
    draft = path.with_suffix('.tmp')
    draft.write_text(f'{json.dumps(content, indent=1, allow_nan=False)}\n', encoding='utf-8')
    draft.replace(path)
