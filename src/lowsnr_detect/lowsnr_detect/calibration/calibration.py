"""
Thresholds for a wanted false-alarm probability a frame, kept from one start to the next.

Detectors compare only at the same share of empty frames with a declaration, and no closed
form gives it for any but the simplest, so it is simulated
(:mod:`lowsnr_detect.calibration.false_alarms`).

A rare alarm, or a large frame, would need very many frames.  There the quantile comes from the
tail fitted to the largest values, and a statistic that is a maximum over cells (``local``) is
simulated on a part of the frame: the frame is without an alarm where all its parts are, so
``1 - p`` of the part is that of the frame to the power of its share of the cells.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from dataclasses import dataclass
from dataclasses import replace
import math
from pathlib import Path
from typing import Any

from lowsnr_common.settings.config import flat_values
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_detect.calibration.cache import cache_key
from lowsnr_detect.calibration.cache import default_folder
from lowsnr_detect.calibration.cache import load
from lowsnr_detect.calibration.cache import save
from lowsnr_detect.calibration.false_alarms import find_threshold
from lowsnr_detect.calibration.false_alarms import Progress
from lowsnr_detect.calibration.false_alarms import Simulation

PROTOCOL_FRAMES = 40
MOST_CELLS = 64 * 64
_EXPECTED_ALARMS = 400
_MOST_RUNS = 1000
_STEPS = 5


@dataclass(frozen=True)
class Calibration:
    """
    A threshold, and what it rests on.

    Parameters
    ----------
    threshold
        Threshold [nat].
    interval
        Its 95 % confidence interval [nat].
    false_alarm_prob
        Share of empty frames with any declaration that it is for.
    shape
        Rows and columns that it is for.
    simulated_shape
        Rows and columns that were simulated; fewer where the result is extrapolated.
    measured_prob
        Share of the simulated frames with a declaration; less than wanted where the test has
        no more false alarms, however low the threshold.
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


def calibrate(
    detector: Any, false_alarm_prob: float, shape: tuple[int, int], *,
    frames: int = PROTOCOL_FRAMES, runs: int | None = None, seed: int = 0,
    extrapolate: bool = True, progress: Progress | None = None,
) -> Calibration:
    """
    Find the threshold at which a share of empty frames holds a declaration.

    Parameters
    ----------
    detector
        Detector; its own threshold does not matter.
    false_alarm_prob
        Wanted share of empty frames with any declaration, in (0, 1).
    shape
        Rows and columns.
    frames
        Frames of a run, each run from a fresh start.
    runs
        Number of runs; by default for 400 alarms, but no more than 1000.
    seed
        Root seed of noise and detector.
    extrapolate
        Whether to simulate a part of a frame of more than 64 x 64 cells, where that is known
        to do.
    progress
        Called now and then with the share of the work that is done, in [0, 1].

    Raises
    ------
    ValueError
        If the probability is not in (0, 1), or the shape, frames or runs are too few.

    """
    _check(false_alarm_prob, shape, frames, runs)
    part = _part(shape) if extrapolate and getattr(detector, 'local', False) else shape
    share = math.prod(part) / math.prod(shape)
    prob = -math.expm1(share * math.log1p(-false_alarm_prob))
    runs = runs or min(_MOST_RUNS, max(2, math.ceil(_EXPECTED_ALARMS / (prob * frames))))
    simulation = Simulation(runs, frames, part, seed)
    threshold, interval, measured = find_threshold(detector, prob, simulation, progress)
    return Calibration(
        threshold, interval, false_alarm_prob, shape, part, measured, runs, frames, seed)


def calibrated(
    detector: Any, false_alarm_prob: float, shape: tuple[int, int], *,
    folder: Path | None = None, progress: Progress | None = None, **options: Any,
) -> Calibration:
    """
    Return what :func:`calibrate` returns, from the cache where it was made before.

    Parameters
    ----------
    detector, false_alarm_prob, shape, progress
        As for :func:`calibrate`; ``progress`` is not called for a cached result.
    folder
        Folder of the cache; by default the user's.
    **options
        Other arguments of :func:`calibrate`.

    """
    folder = folder or default_folder()
    settings = flat_values(detector)
    del settings['threshold']
    key = cache_key(type(detector), {
        'settings': settings, 'false_alarm_prob': false_alarm_prob, 'shape': list(shape),
        'options': options})
    found = load(folder, key)
    if found is not None and set(found) == set(Calibration.__dataclass_fields__):
        tuples = {name: tuple(value) for name, value in found.items() if isinstance(value, list)}
        return Calibration(**{**found, **tuples})
    made = calibrate(detector, false_alarm_prob, shape, progress=progress, **options)
    save(folder, key, asdict(made))
    return made


def at_operating_point(
    name: str, detector: Any, operating: DetectionSettings, shape: tuple[int, int], *,
    log: Callable[[str], None], check: Callable[[], None] | None = None,
    folder: Path | None = None,
) -> Any:
    """
    Return the detector with the thresholds of its operating point.

    Parameters
    ----------
    name
        Name it is registered under, for the log.
    detector
        Detector with the threshold set by hand.
    operating
        Which operating point, and its false-alarm probability.
    shape
        Rows and columns.
    log
        Told what is done, a sentence at a time: calibration takes seconds.
    check
        Called again and again meanwhile; raises to end it.
    folder
        Folder of the cache; by default the user's.

    """
    if operating.operating_point == 'nominal':
        return detector.nominal()
    if operating.operating_point == 'manual':
        return detector
    prob, size = operating.false_alarm_prob, f'{shape[1]} x {shape[0]} cells'
    found = calibrated(
        detector, prob, shape, folder=folder,
        progress=_told(
            log, f'{name}: calibrating to {prob:g} false alarms a frame of {size}', check))
    log(f'{name}: threshold {found.threshold:.2f} nat (95 %: {found.interval[0]:.2f} to '
        f'{found.interval[1]:.2f}) for {prob:g} false alarms a frame of {size}')
    return replace(detector, threshold=found.threshold)


def _told(
    log: Callable[[str], None], what: str, check: Callable[[], None] | None,
) -> Progress:
    """Return a progress callback that checks, and logs every fifth of the way."""
    said = -1

    def progress(done: float) -> None:
        nonlocal said
        if check:
            check()
        step = math.floor(done * _STEPS)
        if step > said:
            said = step
            log(f'{what}, {100 * step // _STEPS} % done')

    return progress


def _part(shape: tuple[int, int]) -> tuple[int, int]:
    """Return the part of a frame to simulate: at most ``MOST_CELLS``, as square as it can be."""
    rows, cols = shape
    if rows * cols <= MOST_CELLS:
        return shape
    short = min(rows, cols, math.isqrt(MOST_CELLS))
    long = MOST_CELLS // short
    return (short, long) if rows <= cols else (long, short)


def _check(prob: float, shape: tuple[int, int], frames: int, runs: int | None) -> None:
    if not 0.0 < prob < 1.0:
        raise ValueError(f'false_alarm_prob = {prob!r}, must be a number in (0, 1)')
    for name, value, least in (
            ('rows', shape[0], 1), ('cols', shape[1], 1), ('frames', frames, 1),
            ('runs', 2 if runs is None else runs, 2)):
        if value < least:
            raise ValueError(f'{name} = {value!r}, must be at least {least}')
