# SPDX-License-Identifier: Apache-2.0
"""The figures of a study: captions, data, and drawing on workers."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from lowsnr_common.core.motion import POS
from lowsnr_eval.report import figure_style
from lowsnr_eval.report import figures
from lowsnr_eval.report import trade_offs
from lowsnr_eval.report.ceiling import ceiling
from lowsnr_eval.report.ceiling import has_ceiling
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
_CEILING = (
    'The ceiling is that of a test that knows the path of the object and its first frame, at the '
    'same P_FA in every frame: no detector can pass it.')
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
    plan |= _trade_offs(results, len(frames))
    return plan


def draw_all(workers: Workers, plan: Plan) -> dict[str, tuple[str, bytes]]:
    """Draw the figures of a plan on workers; return SVG and PNG by name."""
    drawn: dict[str, tuple[str, bytes]] = {}
    workers.run(_draw, {name: (make,) for name, (_, make) in plan.items()}, drawn.__setitem__)
    return drawn


def _draw(make: Callable[[], Figure]) -> tuple[str, bytes]:
    return figure_style.render(make())


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


def _trade_offs(results: StudyResults, frames: int) -> Plan:
    """
    Return P_D against P_FA, P_D against SNR, and the CPU time for a frame.

    ``frames`` is the number of frames with the object.
    """
    study = results.study
    few, asked = study.options.few_runs, _asked(results)
    curves = {f'{snr:g} dB, {few} runs or more': {
        name: (roc(results, snr, name), roc(results, snr, name, ('nominal',)))
        for name in study.labels} for snr in study.snrs_db}
    snrs = {f'{point} thresholds, {few} runs or more': {
        name: snr_curve(results, name, point) for name in study.labels} for point in POINTS}
    sensor = study.cases[0].sensor
    tops: tuple[dict[str, np.ndarray], dict[str, np.ndarray]] = ({}, {})
    if has_ceiling(sensor):
        pfas = np.geomspace(1e-4, 0.9, 60)
        tops = (
            {title: np.array([pfas, ceiling(replace(sensor, snr_db=snr), pfas, frames)])
             for title, snr in zip(curves, study.snrs_db)},
            {title: _ceiling_over_snr(results, frames, asked[0])
             for title, point in zip(snrs, POINTS) if point == 'matched' and len(asked) == 1})
    return {
        'roc': (f'P_D against P_FA of detections, with 95 % intervals. Dotted: {_percent(asked)} '
                f'of empty frames, which matched thresholds ask for; stars: nominal thresholds. '
                f'{_CEILING * bool(tops[0])}',
                partial(trade_offs.detection_against_false_alarms, curves, asked, tops[0])),
        'snr': (f'P_D of detections against SNR, with 95 % intervals. '
                f'{_CEILING * bool(tops[1])}',
                partial(trade_offs.detection_against_snr, snrs, tops[1])),
        'time': (
            'CPU time for a frame.',
            partial(trade_offs.time_per_frame, median_times(results)))}


def _asked(results: StudyResults) -> list[float]:
    """Return the false-alarm probabilities that matched thresholds ask for."""
    return sorted({method.false_alarm_prob for case in results.study.cases
                   for method in case.methods})


def _percent(probs: Sequence[float]) -> str:
    return ' and '.join(f'{100.0 * prob:g} %' for prob in probs)


def _ceiling_over_snr(results: StudyResults, frames: int, pfa: float) -> np.ndarray:
    """Return SNR and greatest P_D, (2, n), over the SNRs of a study."""
    sensor, known = results.study.cases[0].sensor, [
        case.snr_db for case in results.study.cases]
    snrs = np.linspace(min(known), max(known), 40)
    return np.array([snrs, [
        float(ceiling(replace(sensor, snr_db=snr), np.array(pfa), frames)) for snr in snrs]])


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
