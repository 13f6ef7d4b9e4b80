# SPDX-License-Identifier: Apache-2.0
"""Figures of what is traded for what: P_D against P_FA, against SNR, and the time for a frame."""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from typing import Any

from lowsnr_eval.report.figure_style import COLOURS
from lowsnr_eval.report.figure_style import legend_below
from lowsnr_eval.report.figure_style import MARKERS
from lowsnr_eval.report.figure_style import marking
from lowsnr_eval.report.figure_style import new_figure
from lowsnr_eval.report.figure_style import STYLE
import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

_CEILING: Any = {'color': '0.6', 'linewidth': 3.0, 'label': 'ceiling: path known'}
# Figures with their bounds, a row a point.
Points = Sequence[tuple[float, ...]]


@mpl.rc_context(STYLE)
def detection_against_false_alarms(
    panels: Mapping[str, Mapping[str, tuple[Points, Points]]], asked: Sequence[float],
    ceilings: Mapping[str, np.ndarray],
) -> Figure:
    """
    Draw P_D against P_FA of each method, a panel for each SNR.

    ``panels`` holds two lists of P_FA and P_D, each followed by its bounds, for each method: its
    curve, and its nominal operating point, which becomes a star.  ``asked`` are the false-alarm
    probabilities of matched thresholds, ``ceilings`` P_FA and greatest P_D, (2, n), by panel.
    """
    figure, all_axes = new_figure(max(5.4, 3.6 * len(panels) + 0.4), 4.2, 1, len(panels))
    for axes, (title, methods) in zip(all_axes, panels.items()):
        if title in ceilings:
            axes.plot(*ceilings[title], **_CEILING)
        for number, (label, (curve, nominal)) in enumerate(methods.items()):
            _draw_points(axes, _above_zero(curve), marking(number), label)
            _draw_points(axes, _above_zero(nominal), {
                'color': marking(number)['color'], 'linestyle': 'none', 'markersize': 10,
                'marker': '*', 'markeredgecolor': 'black'})
        for pfa in asked:
            axes.axvline(pfa, color='0.4', linewidth=0.8, linestyle=':')
        axes.set(xscale='log', ylim=(0.0, 1.02), title=title,
                 xlabel='$P_{FA}$ per empty frame', ylabel='$P_D$')
    legend_below(figure, all_axes[0])
    return figure


@mpl.rc_context(STYLE)
def detection_against_snr(
    panels: Mapping[str, Mapping[str, Points]], ceilings: Mapping[str, np.ndarray],
) -> Figure:
    """
    Draw P_D against SNR of each method, a panel for each operating point.

    ``panels`` holds SNR, P_D and its bounds, ``ceilings`` SNR and greatest P_D, (2, n), by panel.
    """
    figure, all_axes = new_figure(7.4, 3.7, 1, len(panels))
    for axes, (title, methods) in zip(all_axes, panels.items()):
        if title in ceilings:
            axes.plot(*ceilings[title], **_CEILING)
        for number, (label, curve) in enumerate(methods.items()):
            _draw_points(
                axes, [(snr, snr, snr, *rest) for snr, *rest in curve], marking(number), label)
        axes.set(ylim=(0.0, 1.02), title=title, xlabel='SNR [dB]', ylabel='$P_D$, detections')
    legend_below(figure, next(
        (axes for axes, title in zip(all_axes, panels) if title in ceilings), all_axes[0]))
    return figure


@mpl.rc_context(STYLE)
def time_per_frame(times_s: Mapping[str, tuple[float, float]]) -> Figure:
    """Draw the CPU time of detector and tracker for a frame, on a log scale."""
    figure, (axes,) = new_figure(7.0, 0.3 * len(times_s) + 1.3, 1, 1)
    values = 1e3 * np.array(list(times_s.values())).reshape(-1, 2)
    for number, name in enumerate(('detector, in a batch of runs', 'tracker')):
        axes.plot(values[:, number], list(times_s), linestyle='none', markersize=6, label=name,
                  color=COLOURS[number], marker=MARKERS[number])
    axes.invert_yaxis()
    axes.set(xscale='log', xlabel='CPU time for a frame [ms]')
    legend_below(figure, axes)
    return figure


def _above_zero(points: Points) -> Points:
    """Return the points that a logarithmic axis has, with lower bounds that it has."""
    return [(x, max(low, x / 1e3), *rest) for x, low, *rest in points if x > 0.0]


def _draw_points(
    axes: Axes, points: Points, look: Mapping[str, Any], label: str | None = None,
) -> None:
    """Draw points, each with the bounds of x and y."""
    if points:
        x, x_low, x_high, y, y_low, y_high = np.transpose(points)
        axes.errorbar(
            x, y, label=label, elinewidth=0.7, capsize=1.5, **look,
            xerr=np.maximum([x - x_low, x_high - x], 0.0),
            yerr=np.maximum([y - y_low, y_high - y], 0.0))
