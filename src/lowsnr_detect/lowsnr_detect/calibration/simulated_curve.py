# SPDX-License-Identifier: Apache-2.0
"""
The curve of threshold against false-alarm probability, from simulated empty frames.

Empty frames are simulated as they are scored: in runs of a stated number of frames, each from a
fresh start.  With Q(p) the value that the statistic exceeds with probability p, the threshold
for p is Q(p) (:mod:`lowsnr_detect.calibration.threshold_search`).  Runs are added until the
fraction of alarms at the threshold for 0.01 is known to 15 % (95 % interval), or the effort is
spent (:mod:`lowsnr_detect.calibration.effort`).

For a rare alarm Q comes from the tail fitted to the largest values
(:mod:`lowsnr_detect.calibration.tail_quantile`).  A statistic that is a maximum over cells
(``local``) is simulated on a part of a large frame: a frame is without an alarm if all its parts
are, so that ``1 - p`` of the part is that of the frame to the power of its fraction of the cells.

The posterior odds of one object in a frame of A cells are a mean over cells, of terms whose tail
falls as 1 / odds.  With A there are more terms, each of which counts less, so that the threshold
for a rare alarm depends on A no more than on the noise of a simulation.  That of a frame that is
too costly is therefore the threshold of a part, with 0.3 nat more in its interval.
"""

from __future__ import annotations

from lowsnr_detect.calibration.curve import Curve
from lowsnr_detect.calibration.curve import log_odds
from lowsnr_detect.calibration.curve import part_prob
from lowsnr_detect.calibration.effort import most_runs
from lowsnr_detect.calibration.effort import simulated_part
from lowsnr_detect.calibration.empty_frames import Progress
from lowsnr_detect.calibration.empty_frames import Simulation
from lowsnr_detect.calibration.threshold_search import ThresholdSearch
from lowsnr_detect.parts.detector import Detector
import numpy as np

# The false-alarm probability that the simulation is made for, the default of the project.
DESIGN_PROB = 0.01
PROTOCOL_FRAMES = 40
# Points of the curve: the log odds of 2e-9 to 0.99995 in steps that a straight line bridges to
# 0.001 nat, and a few beyond, where no simulation can check the fitted tail.
_LOG_ODDS = (-700.0, -300.0, -100.0, -50.0, -30.0, *np.arange(-20.0, 10.01, 0.25).tolist())
# Difference between the thresholds of a posterior in 32 x 32 cells and in larger frames that
# simulations do not exclude, for alarms in up to a tenth of the frames [nat].
_SIZE_ERROR = 0.3


def simulate_curve(
    detector: Detector, shape: tuple[int, int], *, frames: int = PROTOCOL_FRAMES,
    runs: int | None = None, seed: int = 0, extrapolate: bool = True,
    progress: Progress | None = None,
) -> Curve:
    """
    Simulate the threshold for every false-alarm probability.

    Parameters
    ----------
    detector
        Detector; its own threshold does not matter.
    shape
        Rows and columns.
    frames
        Frames of a run, each run from a fresh start.
    runs
        Number of runs; by default as many as are needed, and no more than are affordable.
    seed
        Root seed of noise and detector.
    extrapolate
        Whether to simulate a part of a large frame.
    progress
        Called now and then with the fraction of the work that is done, in [0, 1].

    Raises
    ------
    ValueError
        If the shape, frames or runs are too few.

    """
    for name, value, least in (
            ('rows', shape[0], 1), ('cols', shape[1], 1), ('frames', frames, 1),
            ('runs', 2 if runs is None else runs, 2)):
        if value < least:
            raise ValueError(f'{name} = {value!r}, must be at least {least}')
    part = simulated_part(detector, shape, frames) if extrapolate else shape
    prob = part_prob(DESIGN_PROB, shape, part) if detector.local else DESIGN_PROB
    odds = np.unique([*_LOG_ODDS, log_odds(prob)])
    search = ThresholdSearch(
        detector, Simulation(runs or most_runs(detector, part, frames), frames, part, seed),
        progress, early=runs is None)
    threshold, low, high, measured = search.points(prob, odds)
    if part != shape and not detector.local:
        low, high = low - _SIZE_ERROR, high + _SIZE_ERROR
    return Curve(
        shape, part, search.simulation.runs, frames, seed, detector.local, tuple(odds.tolist()),
        tuple(threshold.tolist()), tuple(low.tolist()), tuple(high.tolist()),
        tuple(measured.tolist()))
