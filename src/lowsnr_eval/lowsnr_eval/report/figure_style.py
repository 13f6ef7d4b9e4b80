# SPDX-License-Identifier: Apache-2.0
"""
The look of all figures, and their files: SVG and PNG.

Line styles are the paper's, solid and dashed.  The colours are those of Okabe and Ito, which
colour-blind readers can tell apart, and every method has its own marker.
"""

from __future__ import annotations

import io
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

COLOURS = ('#0072B2', '#D55E00', '#009E73', '#CC79A7', '#E69F00', '#56B4E9', '#000000',
           '#8A8A00', '#7F7F7F')
MARKERS = 'osD^vPX*<'
STYLE: Any = {
    'font.size': 9, 'axes.grid': True, 'axes.titlesize': 9, 'grid.alpha': 0.3,
    'axes.spines.top': False, 'axes.spines.right': False, 'svg.fonttype': 'path',
    'svg.hashsalt': 'lowsnr',
    'legend.frameon': False, 'legend.fontsize': 8, 'lines.linewidth': 1.6,
    'lines.markersize': 4.5, 'figure.constrained_layout.use': True}
_DOTS_PER_INCH = 150


@mpl.rc_context(STYLE)
def render(figure: Figure) -> tuple[str, bytes]:
    """Return a figure as SVG text and as PNG bytes, the same bytes every time."""
    svg, png = io.StringIO(), io.BytesIO()
    figure.savefig(svg, format='svg', metadata={'Date': None})
    figure.savefig(png, format='png', dpi=_DOTS_PER_INCH)
    return svg.getvalue(), png.getvalue()


def new_figure(
    width: float, height: float, rows: int, cols: int,
) -> tuple[Figure, list[Axes]]:
    """Return a figure [inches] and its axes, row by row."""
    figure = Figure(figsize=(width, height))
    return figure, list(np.ravel(figure.subplots(rows, cols, squeeze=False)))


def marking(number: int) -> dict[str, Any]:
    """Return colour and marker of the method of a number."""
    number %= len(COLOURS)
    return {'color': COLOURS[number], 'marker': MARKERS[number]}


def legend_below(figure: Figure, axes: Axes) -> None:
    """Put the legend of these axes below the figure."""
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc='outside lower center',
                      ncols=min(4, len(labels)))
