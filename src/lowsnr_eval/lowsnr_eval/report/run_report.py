# SPDX-License-Identifier: Apache-2.0
"""The report of one run of the node graph: an animation of its frames, tables and curves."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
import csv
from itertools import product
import json
from pathlib import Path
from typing import Any

from lowsnr_bringup.run.results_folder import FRAMES_FILE
from lowsnr_bringup.run.results_folder import PARAMETERS_FILE
from lowsnr_bringup.run.results_folder import SUMMARY_FILE
from lowsnr_common.settings.text import one_line
from lowsnr_eval.report import figures
from lowsnr_eval.report import html_page as pages
from lowsnr_eval.report.animation import animation
from lowsnr_eval.report.animation import Facts
from lowsnr_eval.report.figure_style import render
from lowsnr_eval.report.html_page import Markup
from lowsnr_eval.report.table import format_table
from lowsnr_eval.report.table import unit_of
from lowsnr_eval.scene.scene_files import read_scene
from lowsnr_eval.scene.scene_files import SCENE_FILE
from lowsnr_eval.track_metrics.metrics_table import format_metrics
from lowsnr_eval.track_metrics.reliability_figure import reliability
import numpy as np

REPORT_FILE = 'report.html'
# More dots than this overlap, and the file grows large.
_MOST_DOTS = 250
# Lines may be missing, but a damaged number must not ask for more memory than there is.
_MOST_FRAMES_A_LINE = 1000
# The errors that damaged results may raise.
_DAMAGED = (
    OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, MemoryError,
    RecursionError, csv.Error)
_ALARM_RATES = (
    'Asked: the share of the frames without object that may hold a detection. Scored: the share '
    'of those of this run that do, with the interval of Wilson. Measured: what a detector with '
    'an adaptive threshold says about its latest frames.')
_MEASURES = ('hits', 'rmse_position_m', 'rmse_velocity_mps', 'gospa_m')


def write_run_report(folder: Path, command: str) -> Path:
    """
    Write ``report.html`` into the results folder of a run.

    Parameters
    ----------
    folder
        Folder with ``summary.json`` and ``frames.csv``, and, for the animation, with the files
        of :class:`lowsnr_eval.scene.scene_writer.SceneWriter`.
    command
        Command that repeats the run.

    Returns
    -------
    Path
        The report.

    Raises
    ------
    ValueError
        One line, if the results are damaged.

    """
    try:
        page = _page(folder, command)
    except _DAMAGED as error:
        raise ValueError(f'{folder}: the results are damaged: '
                         f'{type(error).__name__} {one_line(error)}') from None
    path = folder / REPORT_FILE
    try:
        path.write_text(page, encoding='utf-8', errors='replace')
    except OSError:
        path.unlink(missing_ok=True)  # on a full disk, scores have better use for the room
        raise
    return path


def _page(folder: Path, command: str) -> str:
    summary = json.loads((folder / SUMMARY_FILE).read_text(encoding='utf-8'))
    parameters = _parameters(folder)
    sections = []
    if (folder / SCENE_FILE).is_file():
        scene = read_scene(folder)
        if any(frame is not None for frame in scene.frames):
            scored = summary['frames']['scored'] + summary['frames']['unanswered']
            sections.append(pages.section('Frames', animation(
                scene, scored, _facts(summary, parameters))))
    sections += [
        pages.section('Figures', pages.preformatted(format_table(summary))),
        *_track_metrics(summary),
        pages.section('False-alarm rate', _alarm_rates(summary), _ALARM_RATES),
        pages.section('Frame by frame', _curves(
            folder, list(summary['detectors']), *unit_of(summary['evaluation']))),
        pages.section('How to run again', pages.preformatted(command), pages.versions())]
    if parameters:
        sections.append(pages.section(
            'Parameters', pages.folded(PARAMETERS_FILE, pages.preformatted(parameters))))
    return pages.page(_title(summary, parameters), sections)


def _parameters(folder: Path) -> str:
    """Return the text of the parameters of a run, empty where it left none."""
    path = folder / PARAMETERS_FILE
    return path.read_text(encoding='utf-8') if path.is_file() else ''


def _simulated(parameters: str) -> bool:
    """Return whether the frames of a run come from the simulated sensor."""
    return any(line.startswith('/sensor:') for line in parameters.splitlines())


def _title(summary: Mapping[str, Any], parameters: str) -> str:
    """Return what was looked at, the SNR, and the detectors."""
    snr = f'{summary["evaluation"]["sensor.snr_db"]:g} dB'
    known = f'SNR {snr}' if _simulated(parameters) else f'expected SNR {snr}'
    return f'{summary["scenario"]}, {known}: {", ".join(summary["detectors"])}'


def _facts(summary: Mapping[str, Any], parameters: str) -> Facts:
    evaluation = summary['evaluation']
    unit, size_m = unit_of(evaluation)
    return Facts(
        unit, evaluation['sensor.cell_size_m'] / size_m, evaluation['gate_cells'],
        {name: own.get('pfa_asked') for name, own in summary['detectors'].items()},
        'amplitude' if _simulated(parameters) else 'pixel value')


def _alarm_rates(summary: Mapping[str, Any]) -> Markup:
    """Return the false-alarm rates of each detector: asked, scored, and as it measures it."""
    rows = []
    for name, own in summary['detectors'].items():
        scored, interval = own['detection']['pfa_per_frame'], own['detection']['pfa_interval']
        rows.append((
            name, own.get('pfa_asked'), scored,
            None if interval is None else f'{interval[0]:.4f} to {interval[1]:.4f}',
            own['detection']['frames_without_object'], own.get('pfa_measured')))
    return pages.table((
        'detector', 'asked', 'scored', '95 % interval', 'frames without object',
        'measured by the detector'), rows)


def _track_metrics(summary: Mapping[str, Any]) -> list[Markup]:
    """Return a section of the metrics of tracks, none where the summary has none."""
    text = format_metrics(summary)
    if not text:
        return []
    drawn = {name: reliability(own['track_metrics']['existence_calibration'])
             for name, own in summary['detectors'].items() if own.get('track_metrics')}
    return [pages.section('Tracks', pages.preformatted(text), *(
        pages.picture(
            render(figure)[0], f'{name}: existence that tracks state, and the share of those '
            'tracks that are on an object, with Wilson 95 % intervals.')
        for name, figure in drawn.items() if figure))]


def _curves(folder: Path, names: list[str], unit: str, size_m: float) -> Markup:
    """Draw the figures of merit in ``frames.csv``, for detections and tracks of every chain."""
    read: dict[tuple[str, str, str], dict[int, float]] = defaultdict(dict)
    present, count = set(), 0
    with (folder / FRAMES_FILE).open(encoding='utf-8', newline='') as file:
        reader = csv.DictReader(file)
        for row in reader:
            count = int(row['frame'])
            if not 0 < count <= _MOST_FRAMES_A_LINE * reader.line_num:
                raise ValueError(f'{FRAMES_FILE}: line {reader.line_num}: frame {count}')
            if int(row['objects'] or 0):
                present.add(count)
            for measure in _MEASURES:
                if row[measure] and (measure != 'hits' or count in present):
                    read[row['detector'], row['level'], measure][count] = float(
                        row[measure]) / (1.0 if measure == 'hits' else size_m)
    if not count:
        return Markup('<p>No frame was scored.</p>')
    width = -(-count // _MOST_DOTS)
    curves = {key: _means(read[key], count, width)
              for key in product(names, ('detection', 'tracking'), _MEASURES)}
    shaded = sorted(present) if width == 1 else ()
    caption = ('The shaded frames hold an object.' if width == 1
               else f'Each dot is the mean of {width} frames.')
    return pages.picture(
        render(figures.single_run(names, _MEASURES, curves, shaded, unit))[0], caption)


def _means(values: dict[int, float], count: int, width: int) -> np.ndarray:
    """Return values by frame as a curve, (count,), of the means of ``width`` frames at a time."""
    curve = np.full(-(-count // width) * width, np.nan)
    curve[np.array(list(values), dtype=int) - 1] = list(values.values())
    blocks = curve.reshape(-1, width)
    known = np.isfinite(blocks)
    total, number = np.where(known, blocks, 0.0).sum(axis=1), known.sum(axis=1)
    means = np.full_like(blocks, np.nan)
    means[:, width // 2] = np.divide(
        total, number, out=np.full(len(blocks), np.nan), where=number > 0)
    return means.ravel()[:count]
