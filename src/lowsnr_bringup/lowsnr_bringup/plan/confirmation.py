# SPDX-License-Identifier: Apache-2.0
"""
The existence probability at which tracks are confirmed, for a rate of false tracks.

Confirmation hardly acts on the filter: of two tracks that are merged, the confirmed one stays.
One simulation of detector and tracker on empty frames therefore gives the whole curve: the false
tracks a frame at a threshold are the tracks whose largest existence reaches it, over the number
of frames.  Where fewer than a hundred reach it, the threshold comes from the tail fitted to the
largest log odds (:mod:`lowsnr_detect.calibration.tail_quantile`).

Of a large frame a part is simulated: its false tracks are in proportion to its cells, but where
the statistic is the posterior of the one object in the frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from dataclasses import dataclass
from dataclasses import replace
import hashlib
import math
from pathlib import Path
from typing import Any
import warnings

from lowsnr_bringup.plan import empty_tracks
from lowsnr_bringup.plan import graph
from lowsnr_bringup.plan.empty_tracks import RUN_FRAMES
from lowsnr_bringup.plan.empty_tracks import simulate
from lowsnr_bringup.plan.run_plan import RunPlan
from lowsnr_bringup.run.progress import calibration_progress
from lowsnr_common.core.streams import stream
from lowsnr_common.settings.flat_values import flat_values
from lowsnr_common.settings.frame_period import at_unit_period
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_detect.adaptive.adaptive_detector import AdaptiveDetector
from lowsnr_detect.calibration.cache import cache_key
from lowsnr_detect.calibration.cache import default_folder
from lowsnr_detect.calibration.cache import load
from lowsnr_detect.calibration.cache import save
from lowsnr_detect.calibration.cache import Warn
from lowsnr_detect.calibration.curve import part_prob
from lowsnr_detect.calibration.effort import simulated_part
from lowsnr_detect.calibration.empty_frames import Progress
from lowsnr_detect.calibration.operating_point import at_operating_point
from lowsnr_detect.calibration.operating_point import curve
from lowsnr_detect.calibration.tail_quantile import upper_quantile
from lowsnr_detect.parts.detector import Detector
import lowsnr_track
from lowsnr_track.pda_mmpf import PdaMmpf
from lowsnr_track.tracks import MAX_EXISTENCE
import numpy as np
import scipy

_BOOTSTRAPS = 200


@dataclass(frozen=True)
class Confirmation:
    """
    The existence probability of confirmation for one rate of false tracks, with its evidence.

    Parameters
    ----------
    probability, low, high
        Existence probability of confirmation, and its 95 % interval by bootstrap over runs.
    asked, measured
        False tracks a frame: asked, and at this probability in the simulated frames.
    tracks
        False tracks that were confirmed in the simulation.
    runs
        Runs of ``RUN_FRAMES`` frames.
    shape, simulated_shape
        Rows and columns that it is for, and that were simulated.

    """

    probability: float
    low: float
    high: float
    asked: float
    measured: float
    tracks: int
    runs: int
    shape: tuple[int, int]
    simulated_shape: tuple[int, int]

    def __str__(self) -> str:
        """Return what was asked and found, as a sentence."""
        return (
            f'confirm_probability {self.probability:.4g} (95 %: {self.low:.4g} to '
            f'{self.high:.4g}) for {self.asked:g} false tracks a frame of {self.shape[1]} x '
            f'{self.shape[0]} cells; simulated {self.measured:.3g} ({self.tracks} in '
            f'{self.runs * RUN_FRAMES} empty frames of {self.simulated_shape[1]} x '
            f'{self.simulated_shape[0]} cells)')

    def settings(self, tracker: PdaMmpf) -> dict[str, float]:
        """Return the settings of a tracker that confirms so, by name; it releases no earlier."""
        return {
            'life.confirm_probability': self.probability,
            'life.release_probability': min(self.probability, tracker.life.release_probability)}


def confirm_at_rate(plan: RunPlan, warn: Warn) -> list[str]:
    """Set when the trackers of a run confirm, where a rate is asked; return a line for each."""
    lines = []
    for path, detector in plan.detectors.items():
        values = plan.parameters[path]
        own = plan.parameters[node := f'{path.rpartition("/")[0]}/tracker']
        if not own.get('life.false_tracks'):
            continue
        tracker, shape = graph.build(PdaMmpf, own, node), (values['rows'], values['cols'])
        operating = graph.build(DetectionSettings, values, path)
        if operating.operating_point == 'matched':
            name = path.rpartition('/')[2].removesuffix('_detector')
            with calibration_progress(name, shape, detector.sensor.snr_db) as show:
                curve(detector, shape, progress=show, warn=warn)
        with calibration_progress(node.strip('/'), shape, detector.sensor.snr_db) as show:
            found = confirmation((detector, operating), tracker, shape, progress=show, warn=warn)
        own |= found.settings(tracker)
        lines.append(f'{node.strip("/").replace("/", ".")}: {found}')
    return lines


def confirmation(
    settings: tuple[Detector, DetectionSettings], tracker: PdaMmpf, shape: tuple[int, int], *,
    seed: int = 0, folder: Path | None = None, progress: Progress | None = None,
    warn: Warn = warnings.warn,
) -> Confirmation:
    """
    Return the confirmation for ``tracker.life.false_tracks``: from disk, or simulated and kept.

    Parameters
    ----------
    settings
        Detector with the threshold that the user set, and its operating point.
    tracker
        Tracker.
    shape
        Rows and columns of a frame.
    seed
        Root seed of the simulation.
    folder
        Folder of the calibrations; by default the user's.
    progress
        Called now and then with the fraction of the work that is done.
    warn
        Receives a line for a file that cannot be used, and for one that cannot be written.

    Raises
    ------
    ValueError
        If the size of the frames is not known.

    """
    if min(shape) < 1:
        raise ValueError(
            'tracker.life.false_tracks needs the size of the frames: set rows and cols, or '
            'life.false_tracks to 0')
    detector, part = at_unit_period(settings[0]), simulated_part(settings[0], shape, RUN_FRAMES)
    life = replace(tracker.life, confirm_probability=1.0 - 1e-9)  # so that none is
    tracker = replace(at_unit_period(replace(tracker, life=life)), rows=part[0], cols=part[1])
    key = cache_key(type(detector), {
        'settings': flat_values(detector), 'operating': flat_values(settings[1]),
        'tracker': flat_values(tracker), 'tracker_code': _code_digest(), 'shape': list(shape),
        'frames': RUN_FRAMES, 'seed': seed})
    if record := load(folder or default_folder(), key, warn):
        shapes = {name: tuple(record[name]) for name in ('shape', 'simulated_shape')}
        return Confirmation(**{**record, **shapes})
    tuned = _tuned((detector, settings[1]), shape, part, folder, warn)
    scale = math.prod(shape) / math.prod(part) if detector.local else 1.0
    runs = simulate(tuned, tracker, part, tracker.life.false_tracks / scale, seed, progress)
    found = _look_up(runs, tracker, scale, shape, part)
    save(folder or default_folder(), key, asdict(found), warn)
    return found


def _look_up(
    runs: Sequence[np.ndarray], tracker: PdaMmpf, scale: float, shape: tuple[int, int],
    part: tuple[int, int],
) -> Confirmation:
    """Return the threshold for the rate, at least that of deletion, and its interval."""
    asked, bounds = tracker.life.false_tracks, (tracker.life.delete_probability, MAX_EXISTENCE)

    def probability(some: Sequence[np.ndarray]) -> float:
        peaks = np.concatenate(some)
        expected = asked / scale * len(some) * RUN_FRAMES
        if expected >= len(peaks):
            return bounds[0]
        odds = upper_quantile(peaks, expected / len(peaks))
        return float(np.clip(scipy.special.expit(odds), *bounds))

    rng = stream(0, 'calibration', empty_tracks.FIRST_STREAM - 1)
    drawn = rng.integers(len(runs), size=(_BOOTSTRAPS, len(runs)))
    low, high = np.quantile(
        [probability([runs[n] for n in each]) for each in drawn], [0.025, 0.975])
    found = probability(runs)
    tracks = int(np.sum(scipy.special.expit(np.concatenate(runs)) >= found))
    return Confirmation(
        found, float(low), float(high), asked, tracks * scale / (len(runs) * RUN_FRAMES), tracks,
        len(runs), shape, part)


def _tuned(
    settings: tuple[Detector, DetectionSettings], shape: tuple[int, int], part: tuple[int, int],
    folder: Path | None, warn: Warn,
) -> Any:
    """Return the detector for a part of a frame, with the thresholds of the whole frame."""
    detector, operating = settings
    if operating.operating_point == 'adaptive':
        return AdaptiveDetector(
            detector, part_prob(operating.false_alarm_prob, shape, part), part)
    found = curve(detector, shape, folder=folder, warn=warn) if (
        operating.operating_point == 'matched') else None
    return at_operating_point('', detector, operating, found, lambda _: None)


def _code_digest() -> str:
    own = [Path(__file__), Path(empty_tracks.__file__)]
    files = [*own, *sorted(Path(lowsnr_track.__path__[0]).rglob('*.py'))]
    return hashlib.sha256(b''.join(path.read_bytes() for path in files)).hexdigest()
