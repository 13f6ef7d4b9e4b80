# SPDX-License-Identifier: Apache-2.0
"""
The curve of threshold against false-alarm probability, and the look-up on it.

The false-alarm probability is the probability that an empty frame holds any declaration.  A curve
is simulated once for the settings of a detector and a frame size
(:mod:`lowsnr_detect.calibration.simulated_curve`); the threshold for any probability is a look-up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from dataclasses import dataclass
import math
from typing import Any

import numpy as np

# Values at each point of a curve.
_COLUMNS = ('threshold', 'low', 'high', 'measured_prob')


@dataclass(frozen=True)
class Calibration:
    """
    The threshold for one false-alarm probability, with its evidence.

    Parameters
    ----------
    threshold
        Threshold [nat].
    interval
        Its 95 % confidence interval [nat].
    false_alarm_prob
        Fraction of empty frames with any declaration that it is for.
    shape
        Rows and columns that it is for.
    simulated_shape
        Rows and columns that were simulated; fewer where the result is extrapolated.
    measured_prob
        Fraction of the simulated frames with a declaration; less than wanted where the test has
        no more false alarms at any threshold.
    runs, frames
        Runs simulated, and frames in each, from a fresh start.
    seed
        Root seed of the simulation.

    """

    threshold: float
    interval: tuple[float, float]
    false_alarm_prob: float
    shape: tuple[int, int]
    simulated_shape: tuple[int, int]
    measured_prob: float
    runs: int
    frames: int
    seed: int


@dataclass(frozen=True)
class Curve:
    """
    Threshold against false-alarm probability, with the simulation it comes from.

    Parameters
    ----------
    shape, simulated_shape, runs, frames, seed
        As for :class:`Calibration`.
    local
        Whether the probabilities are those of the simulated part, and not of the frame.
    log_odds
        ``ln(p / (1 - p))`` of the false-alarm probability p, ascending.
    threshold, low, high, measured_prob
        Threshold, its 95 % interval [nat], and measured probability at each of ``log_odds``.

    """

    shape: tuple[int, int]
    simulated_shape: tuple[int, int]
    runs: int
    frames: int
    seed: int
    local: bool
    log_odds: tuple[float, ...]
    threshold: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    measured_prob: tuple[float, ...]

    def at(self, false_alarm_prob: float) -> Calibration:
        """
        Look up the threshold for a false-alarm probability, interpolated in its log odds.

        Raises
        ------
        ValueError
            If the probability is not in (0, 1).

        """
        part = self.simulated_shape if self.local else self.shape
        where = log_odds(part_prob(false_alarm_prob, self.shape, part))
        threshold, low, high, measured = (
            float(np.interp(where, self.log_odds, getattr(self, name))) for name in _COLUMNS)
        return Calibration(
            threshold, (low, high), false_alarm_prob, self.shape, self.simulated_shape, measured,
            self.runs, self.frames, self.seed)

    def record(self) -> dict[str, Any]:
        """Return the curve as values of JSON types."""
        return asdict(self)


def curve_from_record(record: Mapping[str, Any]) -> Curve:
    """Return the curve that a record of :meth:`Curve.record` holds."""
    values: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in record.items()}
    return Curve(**values)


def part_prob(prob: float, shape: tuple[int, int], part: tuple[int, int]) -> float:
    """
    Return the false-alarm probability of a part of a frame, given that of the frame.

    Raises
    ------
    ValueError
        If the probability is not in (0, 1).

    """
    if not 0.0 < prob < 1.0:
        raise ValueError(f'false_alarm_prob = {prob!r}, must be a number in (0, 1)')
    fraction = math.prod(part) / math.prod(shape)
    return max(-math.expm1(fraction * math.log1p(-prob)), 1e-300)


def log_odds(prob: float) -> float:
    """Return ``ln(p / (1 - p))``."""
    return math.log(prob) - math.log1p(-prob)
