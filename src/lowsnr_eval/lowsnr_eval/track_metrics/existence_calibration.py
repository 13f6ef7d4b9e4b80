# SPDX-License-Identifier: Apache-2.0
"""Whether tracks that state a probability of existence have an object as often as they say."""

from __future__ import annotations

from typing import Any

from lowsnr_eval.scoring import metrics
from lowsnr_eval.track_metrics.track_frame import TrackFrame
import numpy as np

BINS = 10


class ExistenceCalibration:
    """
    The reliability diagram of published existence probabilities.

    Tracks of all frames are sorted into ten bins of equal width by their existence probability; 1
    is in the last one.  For each bin: how many, the mean of what they state, and the share that
    has an object.  Objects and tracks are paired one with one within the gate, as in the score of
    a frame, so that a second track of an object has none.  ``error`` is the mean over tracks of
    the absolute difference of both in their bins, the expected calibration error (Naeini, Cooper
    and Hauskrecht, "Obtaining well calibrated probabilities using Bayesian binning", AAAI 2015);
    DeGroot and Fienberg, "The comparison and evaluation of forecasters", The Statistician 32
    (1983), for the diagram.

    Parameters
    ----------
    gate_m
        Largest distance of a track from its object [m].

    """

    def __init__(self, gate_m: float) -> None:
        self._gate_m = gate_m
        self._tracks, self._with_object = np.zeros((2, BINS), dtype=int)
        self._stated = np.zeros(BINS)

    def add(self, frame: TrackFrame) -> None:
        """Add the tracks of a frame; those without a probability are left out."""
        if not frame.track_ids:
            return
        has = np.zeros(len(frame.track_ids), dtype=bool)
        has[metrics.match_within_gate(frame.distance, self._gate_m)[1]] = True
        known = (frame.existence >= 0.0) & (frame.existence <= 1.0)
        stated, has = frame.existence[known], has[known]
        place = np.minimum((stated * BINS).astype(int), BINS - 1)
        np.add.at(self._tracks, place, 1)
        np.add.at(self._stated, place, stated)
        np.add.at(self._with_object, place, has)

    def figures(self) -> dict[str, Any]:
        """Return counts and means of the bins, the lowest first; None where a bin is empty."""
        used, count = self._tracks > 0, int(self._tracks.sum())
        off = float(abs(self._stated - self._with_object).sum())
        means, shares = ([float(a / b) if b else None for a, b in zip(sums, self._tracks)]
                         for sums in (self._stated, self._with_object))
        return {
            'tracks': self._tracks.tolist(), 'stated': means, 'with_object': shares,
            'error': off / count if used.any() else None}
