# SPDX-License-Identifier: Apache-2.0
"""The reliability diagram of a run: published existence against the share that has an object."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lowsnr_eval.report.palette import TRACK
from lowsnr_eval.report.palette import TRUTH
from lowsnr_eval.scoring.metrics import wilson_interval
from matplotlib.figure import Figure
import numpy as np


def reliability(calibration: Mapping[str, Any]) -> Figure | None:
    """
    Draw the ``existence_calibration`` of a chain; None where no track stated a probability.

    Bars are Wilson 95 % intervals, which hold for independent tracks; those of successive frames
    are not quite that.  The numbers are counts of tracks.
    """
    bins = [each for each in zip(
        *(calibration[key] for key in ('tracks', 'stated', 'with_object')), strict=True)
        if each[0]]
    if not bins:
        return None
    figure = Figure(figsize=(3.6, 3.4), layout='constrained')
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color=TRUTH, linestyle='--', label='calibrated')
    counts, stated, shares = np.array(bins).T
    low, high = np.array([
        wilson_interval(round(share * count), int(count)) for count, _, share in bins]).T
    axes.errorbar(
        stated, shares, [np.maximum(shares - low, 0.0), np.maximum(high - shares, 0.0)],
        color=TRACK, marker='o', linestyle='-', capsize=2, label='tracks')
    for count, x, y in zip(counts, stated, shares):
        axes.annotate(f'{count:.0f}', (x, y), xytext=(4, -10), textcoords='offset points',
                      fontsize=7)
    axes.set(xlim=(0, 1), ylim=(0, 1), xlabel='existence stated', ylabel='share with an object')
    axes.legend(loc='upper left', frameon=False)
    return figure
