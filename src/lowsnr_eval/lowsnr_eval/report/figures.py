"""
The figures of Section VI and further ones, as SVG and PNG.

Line styles are the paper's, solid and dashed.  The colours are those of Okabe and Ito, which
colour-blind readers can tell apart, and every method has its own marker.
"""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
import io
from itertools import product
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

_COLOURS = ('#0072B2', '#D55E00', '#009E73', '#CC79A7', '#E69F00', '#56B4E9', '#000000',
            '#8A8A00', '#7F7F7F')
_MARKERS = 'osD^vPX*<'
_STYLE: Any = {
    'font.size': 9, 'axes.grid': True, 'axes.titlesize': 9, 'grid.alpha': 0.3,
    'axes.spines.top': False, 'axes.spines.right': False, 'svg.fonttype': 'path',
    'svg.hashsalt': 'lowsnr',
    'legend.frameon': False, 'legend.fontsize': 8, 'lines.linewidth': 1.6,
    'lines.markersize': 4.5, 'figure.constrained_layout.use': True}
_TITLES = {
    'pd': '$P_D$, or $P_{{FA}}$ outside', 'rmse_position_m': 'RMSE of position [{m}]',
    'rmse_velocity_mps': 'RMSE of velocity [{m}/s]', 'gospa_m': 'GOSPA [{m}]',
    'hits': 'objects hit'}
_LEVELS = {'detection': 'detections', 'tracking': 'tracks'}
_DOTS_PER_INCH = 150
# More bands than this cover each other; the tables hold all of them.
_MOST_BANDS = 4


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


@mpl.rc_context(_STYLE)
def trajectory(path: np.ndarray, shape: tuple[int, int], first_frame: int) -> Figure:
    """Draw the path (frames, 2) [pixels] of the object in a frame of (rows, cols)."""
    figure, (axes,) = _figure(4.2, 4.0, 1, 1)
    axes.plot(path[:, 0], path[:, 1], color=_COLOURS[0], marker='o')
    for n in range(0, len(path), 5):
        axes.annotate(str(first_frame + n), path[n], xytext=(4, 4), textcoords='offset points',
                      fontsize=7)
    axes.locator_params(integer=True)
    axes.set(xlim=(-0.5, shape[1] - 0.5), ylim=(shape[0] - 0.5, -0.5), aspect='equal',
             xlabel='column', ylabel='row', title='trajectory, with frame numbers')
    return figure


@mpl.rc_context(_STYLE)
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
    _legend_below(figure, panels[0][0])
    figure.suptitle(title, fontsize=10)
    return figure


@mpl.rc_context(_STYLE)
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
                      **_marking(n))
            axes.set_xlim(0.5, len(curve) + 0.5)
        for part in np.split(np.array(present), np.flatnonzero(np.diff(present) > 1) + 1):
            if part.size:
                axes.axvspan(part[0] - 0.5, part[-1] + 0.5, color='0.5', alpha=0.08, linewidth=0)
        axes.set_ylim(bottom=0.0)
    _legend_below(figure, panels[0][0])
    return figure


@mpl.rc_context(_STYLE)
def detection_against_false_alarms(
    panels: Mapping[str, Mapping[str, tuple[Sequence[tuple[float, float]], ...]]],
) -> Figure:
    """
    Draw P_D against P_FA of each method, a panel for each SNR.

    ``panels`` holds two lists of (P_FA, P_D) for each method: its curve, and its nominal
    operating point, which becomes a star.
    """
    figure, all_axes = _figure(max(5.4, 3.6 * len(panels) + 0.4), 4.2, 1, len(panels))
    for axes, (title, methods) in zip(all_axes, panels.items()):
        for number, (label, both) in enumerate(methods.items()):
            curve, nominal = (  # a logarithmic axis has no zero
                np.array([(x, y) for x, y in some if x > 0.0]).reshape(-1, 2) for some in both)
            marking = _marking(number)
            axes.plot(*curve.T, label=label, **marking)
            if nominal.size:
                axes.plot(*nominal.T, linestyle='none', markersize=10, marker='*',
                          color=marking['color'], markeredgecolor='black')
        axes.axvline(0.01, color='0.4', linewidth=0.8, linestyle=':')
        axes.set(xscale='log', ylim=(0.0, 1.02), title=title,
                 xlabel='$P_{FA}$ per empty frame', ylabel='$P_D$')
    _legend_below(figure, all_axes[0])
    return figure


@mpl.rc_context(_STYLE)
def detection_against_snr(
    panels: Mapping[str, Mapping[str, Sequence[tuple[float, float]]]],
) -> Figure:
    """Draw P_D against SNR of each method, a panel for each operating point."""
    figure, all_axes = _figure(7.4, 3.7, 1, len(panels))
    for axes, (title, methods) in zip(all_axes, panels.items()):
        for number, (label, curve) in enumerate(methods.items()):
            axes.plot(*np.array(curve).reshape(-1, 2).T, label=label, **_marking(number))
        axes.set(ylim=(0.0, 1.02), title=title, xlabel='SNR [dB]', ylabel='$P_D$, detections')
    _legend_below(figure, all_axes[0])
    return figure


@mpl.rc_context(_STYLE)
def time_per_frame(times_s: Mapping[str, tuple[float, float]]) -> Figure:
    """Draw the CPU time of detector and tracker for a frame, on a log scale."""
    figure, (axes,) = _figure(7.0, 0.3 * len(times_s) + 1.3, 1, 1)
    values = 1e3 * np.array(list(times_s.values())).reshape(-1, 2)
    for number, name in enumerate(('detector, in a batch of runs', 'tracker')):
        axes.plot(values[:, number], list(times_s), linestyle='none', markersize=6, label=name,
                  color=_COLOURS[number], marker=_MARKERS[number])
    axes.invert_yaxis()
    axes.set(xscale='log', xlabel='CPU time for a frame [ms]')
    _legend_below(figure, axes)
    return figure


@mpl.rc_context(_STYLE)
def render(figure: Figure) -> tuple[str, bytes]:
    """Return a figure as SVG text and as PNG bytes, the same bytes every time."""
    svg, png = io.StringIO(), io.BytesIO()
    figure.savefig(svg, format='svg', metadata={'Date': None})
    figure.savefig(png, format='png', dpi=_DOTS_PER_INCH)
    return svg.getvalue(), png.getvalue()


def _figure(width: float, height: float, rows: int, cols: int) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(width, height))
    return figure, list(np.ravel(figure.subplots(rows, cols, squeeze=False)))


def _level_panels(
    measures: Sequence[str], height: float, unit: str = 'm',
) -> tuple[Figure, list[tuple[Axes, str, str]]]:
    """Return panels of measures (rows) for detections and tracks (columns), with titles."""
    figure, panels = _figure(7.4, height, len(measures), len(_LEVELS))
    places = list(zip(panels, *zip(*product(measures, _LEVELS))))
    for axes, measure, level in places:
        if level == 'detection':
            axes.set_ylabel(_TITLES[measure].format(m=unit))
        if measure == measures[0]:
            axes.set_title(_LEVELS[level])
    return figure, places


def _marking(number: int) -> dict[str, Any]:
    number %= len(_COLOURS)
    return {'color': _COLOURS[number], 'marker': _MARKERS[number]}


def _draw_line(
    axes: Axes, line: Series, curves: Mapping[str, np.ndarray], measure: str, band: bool,
) -> None:
    curve = curves[measure]
    if measure == 'pd':
        curve = np.where(np.isnan(curve), curves['declared'], curve)
    if np.isnan(curve[0]).all():
        return
    value, low, high = curve
    frames, marking = np.arange(1, len(value) + 1), _marking(line.number)
    axes.plot(frames, value, linestyle=line.style, label=line.label, markevery=5, **marking)
    if band:
        axes.fill_between(frames, low, high, color=marking['color'], alpha=0.15, linewidth=0)


def _legend_below(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc='outside lower center',
                      ncols=min(4, len(labels)))
