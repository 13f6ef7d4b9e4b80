# SPDX-License-Identifier: Apache-2.0
"""The figures of merit of a run in ``summary.json`` as a table of text."""

from __future__ import annotations

from collections.abc import Mapping
import json
from pathlib import Path
from typing import Any

from lowsnr_bringup.run.results_folder import SUMMARY_FILE
from lowsnr_common.settings.text import printable

_LEVELS = ('detection', 'tracking')
_HEADERS = (
    ('', '', 'P_D', 'P_FA per frame', 'false', 'first hit', 'RMSE', 'RMSE', 'GOSPA'),
    ('detector', 'level', 'per object', 'without object', 'alarms', '[frames]', '[{m}]',
     '[{m}/s]', '[{m}]'),
)
_LEGEND = """
P_D: share of the objects present that were hit within {gate:g} {cells}.
P_FA: share of the frames without object that hold any declaration, those after its end
included, in which detectors that sum over frames still declare it for some frames; as an
adaptive detector measures it: share of its recent frames with a declaration that continues none
before.
false alarms: declarations that hit nothing, in all frames; first hit: after its appearance.
[ , ]: Wilson 95 % interval; -: no such figure.
"""


def format_table(summary: Mapping[str, Any]) -> str:
    """
    Return the figures of a run as aligned text.

    Parameters
    ----------
    summary
        What :func:`lowsnr_eval.scoring.final_summary.summarize` returns.

    Returns
    -------
    str
        Lines without a newline at the end.

    """
    frames, detectors = summary['frames'], summary['detectors']
    published, expected = frames['published'], frames.get('expected')
    early = f' of {expected}' if expected not in (None, published) else ''
    title = (
        f'{printable(summary["scenario"])}, seed {summary["seed"]}: {published}{early} frames '
        f'published, {frames["scored"]} scored, {frames["unanswered"]} unanswered' + ''.join(
            f', {frames[key]} {key}' for key in ('unseen', 'lost') if frames.get(key)))
    if summary['restarts']:
        title += '\nstarted again: ' + ', '.join(
            f'{printable(name)} {count} x' for name, count in summary['restarts'].items())
    evaluation = summary['evaluation']
    unit, size_m = unit_of(evaluation)
    rows = [tuple(text.format(m=unit) for text in row) for row in _HEADERS] + [
        _row(printable(name), level, figures[level], size_m)
        for name, figures in detectors.items() for level in _LEVELS]
    legend = _LEGEND.format(
        gate=evaluation['gate_cells'], cells='cells' if unit == 'm' else 'pixels')
    notes = [_note(printable(name), figures) for name, figures in detectors.items()]
    return '\n'.join([title, '', *_align(rows), legend, *notes])


def unit_of(evaluation: Mapping[str, Any]) -> tuple[str, float]:
    """Return the unit of the positions of a run, and its length in metres."""
    return ('px', evaluation['sensor.cell_size_m']) if evaluation.get('pixels') else ('m', 1.0)


def _row(
    name: str, level: str, figures: Mapping[str, Any], size_m: float,
) -> tuple[str, ...]:
    scored = (figures['frames_with_object'] or 0) + (figures['frames_without_object'] or 0) > 0
    return (
        name, level,
        _share(figures['pd'], figures['pd_interval'], 2),
        _share(figures['pfa_per_frame'], figures['pfa_interval'], 3),
        str(figures['false_alarms']) if scored else '-',
        _number(figures['first_detection_latency_frames'], 1),
        _number(figures['rmse_position_m'], 2, size_m),
        _number(figures['rmse_velocity_mps'], 2, size_m),
        _number(figures['gospa_m'], 2, size_m),
    )


def _note(name: str, figures: Mapping[str, Any]) -> str:
    """Return the numbers of frames behind the figures of a chain, and its latencies."""
    counts, latency = figures['tracking'], figures['latency_ms']
    seen = (
        f'{counts["frames_with_object"]} frames with object, '
        f'{counts["frames_without_object"]} frames without object')
    if counts['frames_with_object'] is None:
        seen = (f'{counts["frames_without_truth"]} frames without truth, in which '
                f'{figures["detection"]["declared"]} detections and {counts["declared"]} tracks '
                'were declared')
    detected, alarms = figures['detection_latency_ms']['median'], figures['detection']
    lag = figures.get('lag_frames', 0)
    late = f'answers {lag} frames late, ' if lag else ''
    return (
        f'{name}: {seen}\n{name}: P_FA asked {_probability(figures.get("pfa_asked"))}, scored '
        f'{_share(alarms["pfa_per_frame"], alarms["pfa_interval"], 3)}, measured by the detector '
        f'{_probability(figures.get("pfa_measured"))}\n{_false_tracks(name, figures)}'
        f'{name}: {late}frame to detections {_number(detected, 1)} ms (median), to tracks '
        f'{_number(latency["median"], 1)} ms (median), {_number(latency["p99"], 1)} ms '
        '(99 %)')


def false_track_lines(folder: Path) -> list[str]:
    """Return the line of each chain of a results folder that was asked for a false-track rate."""
    summary = json.loads((folder / SUMMARY_FILE).read_text('utf-8'))
    return [_false_tracks(name, figures) for name, figures in summary['detectors'].items()]


def _false_tracks(name: str, figures: Mapping[str, Any]) -> str:
    """Return the line about the rate of false tracks, where one was asked for."""
    asked, metrics = figures.get('false_tracks_asked'), figures.get('track_metrics')
    if asked is None or metrics is None:
        return ''
    found = metrics.get('false_tracks') or {
        'per_frame': None, 'per_frame_interval': None, 'tracks': 0, 'frames': 0}
    return (
        f'{name}: false tracks a frame asked {asked:.3g}, scored '
        f'{_share(found["per_frame"], found["per_frame_interval"], 4)}: {found["tracks"]} begin '
        f'in {found["frames"]} frames without object\n')


def _share(value: float | None, interval: list[float] | None, digits: int) -> str:
    if value is None or interval is None:
        return '-'
    low, high = interval
    return f'{value:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]'


def _probability(value: float | None) -> str:
    return '-' if value is None else f'{value:.3g}'


def _number(value: float | None, digits: int, unit: float = 1.0) -> str:
    return '-' if value is None else f'{value / unit:.{digits}f}'


def _align(rows: list[tuple[str, ...]]) -> list[str]:
    """Pad columns to their widest cell: names on the left, figures on the right."""
    widths = [max(map(len, column)) for column in zip(*rows)]
    return [
        '  '.join(
            cell.ljust(width) if n < 2 else cell.rjust(width)
            for n, (cell, width) in enumerate(zip(row, widths))).rstrip()
        for row in rows
    ]
