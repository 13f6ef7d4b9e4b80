"""The figures of a study: captions, data, and drawing on workers."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from lowsnr_common.core.motion import POS
from lowsnr_eval.report import figures
from lowsnr_eval.report.figures import Series
from lowsnr_eval.study.experiment import simulate_run
from lowsnr_eval.study.run_scores import frame_curves
from lowsnr_eval.study.study import LEVELS
from lowsnr_eval.study.study import OBJECT
from lowsnr_eval.study.study import POINTS
from lowsnr_eval.study.study_results import median_times
from lowsnr_eval.study.study_results import roc
from lowsnr_eval.study.study_results import snr_curve
from lowsnr_eval.study.study_results import StudyResults
from lowsnr_eval.study.workers import Workers
from matplotlib.figure import Figure
import numpy as np

_PAPER = ('pd', 'rmse_position_m', 'rmse_velocity_mps')
_STYLES = ('-', '--', ':', '-.')
_RUNS = 'Where two numbers of runs are given, the second is that of the tracks.'
# Caption, and a function that draws the figure in any process.
Plan = dict[str, tuple[str, Callable[[], Figure]]]


def plan_figures(results: StudyResults) -> Plan:
    """Return the figures of a study by file name: caption and drawing function."""
    study = results.study
    truth, _ = simulate_run(
        study.cases[0].scenario, study.cases[0].sensor, study.options.seed, 0)
    frames = np.flatnonzero(np.isfinite(truth[:, 0])) + 1
    present = (int(frames[0]), int(frames[-1]))
    path = truth[frames - 1][:, POS] / study.cases[0].sensor.cell_size_m
    plan: Plan = {'trajectory': (
        'Trajectory of the object.',
        partial(figures.trajectory, path, study.cases[0].scenario.shape, present[0]))}
    plan |= _paper_figures(results, (present, len(truth)))
    plan |= _all_methods(results, (present, len(truth)))
    plan |= _trade_offs(results)
    return plan


def draw_all(workers: Workers, plan: Plan) -> dict[str, tuple[str, bytes]]:
    """Draw the figures of a plan on workers; return SVG and PNG by name."""
    drawn: dict[str, tuple[str, bytes]] = {}
    workers.run(_draw, {name: (make,) for name, (_, make) in plan.items()}, drawn.__setitem__)
    return drawn


def _draw(make: Callable[[], Figure]) -> tuple[str, bytes]:
    return figures.render(make())


def _paper_figures(results: StudyResults, shown: tuple[tuple[int, int], int]) -> Plan:
    """Return the paper's own figures: the methods it compares, at each operating point."""
    plan: Plan = {}
    study = results.study
    example = study.example
    # Also the extension of a method that the paper names in this example.
    extensions = [variant.label for variant in example.variants if variant.label in example.also]
    pair = [name for name in (example.solid, example.dashed, *extensions)
            if name in study.labels] or list(study.labels[:2])
    for point in POINTS:
        if not example.dashed:
            lines = [_series(results, snr, study.labels[0], point, n, f'SNR {snr:g} dB')
                     for n, snr in enumerate(study.snrs_db)]
            plan[f'paper-{point}'] = (
                f'{study.labels[0]} at {point} thresholds, for each SNR. {_RUNS}',
                partial(figures.curves_over_frames, f'{study.labels[0]}, {point}', _PAPER,
                        lines, *shown))
            continue
        for snr in study.snrs_db:
            lines = [_series(results, snr, name, point, n, name) for n, name in enumerate(pair)]
            plan[f'paper-{snr:g}dB-{point}'] = (
                f'The methods that the paper compares at {snr:g} dB, {point} thresholds, with '
                f'95 % bands. {_RUNS}',
                partial(figures.curves_over_frames, f'{snr:g} dB, {point}', _PAPER, lines,
                        *shown))
    return plan


def _all_methods(results: StudyResults, shown: tuple[tuple[int, int], int]) -> Plan:
    return {
        f'all-{snr:g}dB-{point}': (
            f'All detectors at {snr:g} dB, {point} thresholds. {_RUNS}',
            partial(figures.curves_over_frames, f'{snr:g} dB, {point}', ('pd', 'gospa_m'), [
                _series(results, snr, name, point, n, name, style='-')
                for n, name in enumerate(results.study.labels)], *shown))
        for snr in results.study.snrs_db for point in POINTS}


def _trade_offs(results: StudyResults) -> Plan:
    """Return P_D against P_FA, P_D against SNR, and the CPU time for a frame."""
    study = results.study
    few = study.options.few_runs
    curves = {f'{snr:g} dB, {few} runs or more': {
        name: (roc(results, snr, name), roc(results, snr, name, ('nominal',)))
        for name in study.labels} for snr in study.snrs_db}
    snrs = {f'{point} thresholds, {few} runs or more': {
        name: snr_curve(results, name, point) for name in study.labels} for point in POINTS}
    return {
        'roc': ('P_D against P_FA of detections; the dotted line is the matched operating '
                'point, stars are nominal thresholds.',
                partial(figures.detection_against_false_alarms, curves)),
        'snr': ('P_D of detections against SNR.',
                partial(figures.detection_against_snr, snrs)),
        'time': ('CPU time for a frame.', partial(figures.time_per_frame, median_times(results)))}


def _series(
    results: StudyResults, snr_db: float, label: str, point: str, number: int, legend: str,
    style: str = '',
) -> Series:
    scores = results.of(OBJECT, snr_db)
    curves = {level: frame_curves(scores[label, point, level]) for level in LEVELS
              if (label, point, level) in scores}
    runs = [len(scores[label, point, level]) for level in curves]
    text = f'{legend}, {" / ".join(map(str, dict.fromkeys(runs)))} runs'
    return Series(text, style or _STYLES[number % len(_STYLES)], number, curves)
