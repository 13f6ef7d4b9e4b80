# SPDX-License-Identifier: Apache-2.0
"""The figures of Section VI and further ones, over the frames of one or many runs."""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

from lowsnr_eval.report.figure_style import COLOURS
from lowsnr_eval.report.figure_style import legend_below
from lowsnr_eval.report.figure_style import marking
from lowsnr_eval.report.figure_style import new_figure
from lowsnr_eval.report.figure_style import STYLE
import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

_TITLES = {
    'pd': '$P_D$, or $P_{{FA}}$ outside', 'rmse_position_m': 'RMSE of position [{m}]',
    'rmse_velocity_mps': 'RMSE of velocity [{m}/s]', 'gospa_m': 'GOSPA [{m}]',
    'hits': 'objects hit'}
_LEVELS = {'detection': 'detections', 'tracking': 'tracks'}
# More bands than this cover each other: bars at some frames show the intervals then.
_MOST_BANDS, _BAR_EVERY = 4, 5


@dataclass(frozen=True)
class Series:
    """
    One line of a figure.

    Parameters
    ----------
    label
        Legend.
    style
        Line style of matplotlib.
    number
        Selects colour and marker.
    curves
        Value and band, (3, frames), by level and measure; a level may be missing.

    """

    label: str
    style: str
    number: int
    curves: Mapping[str, Mapping[str, np.ndarray]]


@mpl.rc_context(STYLE)
def trajectory(path: np.ndarray, shape: tuple[int, int], first_frame: int) -> Figure:
    """Draw the path (frames, 2) [pixels] of the object in a frame of (rows, cols)."""
    figure, (axes,) = new_figure(4.2, 4.0, 1, 1)
    axes.plot(path[:, 0], path[:, 1], color=COLOURS[0], marker='o')
    for n in range(0, len(path), 5):
        axes.annotate(str(first_frame + n), path[n], xytext=(4, 4), textcoords='offset points',
                      fontsize=7)
    axes.locator_params(integer=True)
    axes.set(xlim=(-0.5, shape[1] - 0.5), ylim=(shape[0] - 0.5, -0.5), aspect='equal',
             xlabel='column', ylabel='row', title='trajectory, with frame numbers')
    return figure


@mpl.rc_context(STYLE)
def curves_over_frames(
    title: str, measures: Sequence[str], series: Sequence[Series],
    present: tuple[int, int], frames: int,
) -> Figure:
    """
    Draw measures (rows) over frames for detections and tracks (columns), with bands.

    In frames without the object the P_D panels show the share of runs with a declaration.
    """
    figure, panels = _level_panels(measures, 2.2 * len(measures) + 0.9)
    for axes, measure, level in panels:
        for line in series:
            if level in line.curves:
                _draw_line(axes, line, line.curves[level], measure, len(series) <= _MOST_BANDS)
        if not axes.has_data():
            axes.text(0.5, 0.5, 'nothing to show', transform=axes.transAxes, ha='center')
        axes.axvspan(present[0] - 0.5, present[1] + 0.5, color='0.5', alpha=0.08, linewidth=0)
        axes.set_ylim(bottom=0.0, top=1.02 if measure == 'pd' else None)
        axes.set_xlim(0.5, frames + 0.5)
        if measure == measures[-1]:
            axes.set_xlabel('frame (shaded: object present)')
    legend_below(figure, panels[0][0])
    figure.suptitle(title, fontsize=10)
    return figure


@mpl.rc_context(STYLE)
def single_run(
    names: Sequence[str], measures: Sequence[str],
    curves: Mapping[tuple[str, str, str], np.ndarray], present: Sequence[int], unit: str = 'm',
) -> Figure:
    """Draw curves by (name, level, measure) over the frames of one run, as dots."""
    figure, panels = _level_panels(measures, 1.5 * len(measures) + 0.7, unit)
    for axes, measure, level in panels:
        for n, name in enumerate(names):
            curve = curves.get((name, level, measure), np.array([]))
            label = name.replace('$', r'\$')  # '$' would begin a formula
            axes.plot(np.arange(1, len(curve) + 1), curve, label=label, linewidth=0.8,
                      **marking(n))
            axes.set_xlim(0.5, len(curve) + 0.5)
        for part in np.split(np.array(present), np.flatnonzero(np.diff(present) > 1) + 1):
            if part.size:
                axes.axvspan(part[0] - 0.5, part[-1] + 0.5, color='0.5', alpha=0.08, linewidth=0)
        if not any(np.isfinite(line.get_ydata()).any() for line in axes.lines):
            axes.text(0.5, 0.5, 'no value', transform=axes.transAxes, ha='center')
            axes.set_yticks([])
        axes.set_ylim(bottom=0.0)
    legend_below(figure, panels[0][0])
    return figure


def _level_panels(
    measures: Sequence[str], height: float, unit: str = 'm',
) -> tuple[Figure, list[tuple[Axes, str, str]]]:
    """Return panels of measures (rows) for detections and tracks (columns), with titles."""
    figure, panels = new_figure(7.4, height, len(measures), len(_LEVELS))
    places = list(zip(panels, *zip(*product(measures, _LEVELS))))
    for axes, measure, level in places:
        if level == 'detection':
            axes.set_ylabel(_TITLES[measure].format(m=unit))
        if measure == measures[0]:
            axes.set_title(_LEVELS[level])
    return figure, places


def _draw_line(
    axes: Axes, line: Series, curves: Mapping[str, np.ndarray], measure: str, band: bool,
) -> None:
    curve = curves[measure]
    if measure == 'pd':
        curve = np.where(np.isnan(curve), curves['declared'], curve)
    if np.isnan(curve[0]).all():
        return
    value, low, high = curve
    frames, own = np.arange(1, len(value) + 1), marking(line.number)
    axes.plot(frames, value, linestyle=line.style, label=line.label, markevery=5, **own)
    if band:
        axes.fill_between(frames, low, high, color=own['color'], alpha=0.15, linewidth=0)
    else:
        axes.errorbar(
            frames, value, np.maximum([value - low, high - value], 0.0), fmt='none',
            ecolor=own['color'], elinewidth=0.7, alpha=0.6,
            errorevery=(line.number % _BAR_EVERY, _BAR_EVERY))
