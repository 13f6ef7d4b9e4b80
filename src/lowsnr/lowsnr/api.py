# SPDX-License-Identifier: Apache-2.0
"""The functions of :mod:`lowsnr`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lowsnr import results
from lowsnr.chain import conditioned
from lowsnr.chain import LOG
from lowsnr.confirmation import confirm_by_frames
from lowsnr.confirmation import RecordedConfirmation
from lowsnr.plan import checked
from lowsnr.plan import checked_shape
from lowsnr.plan import CONFIG
from lowsnr.plan import Options
from lowsnr.plan import plan_chain
from lowsnr.plan import sensor_of
from lowsnr.sequence import is_shown
from lowsnr.sequence import planned
from lowsnr.sequence import run
from lowsnr.sequence import shown_calibration
from lowsnr.sequence import shown_progress
from lowsnr_bringup.plan.sources import find_scenario
from lowsnr_common.core.streams import stream
from lowsnr_detect.calibration.curve import Calibration
from lowsnr_detect.calibration.operating_point import calibrated
from lowsnr_sensor.scenario import load_scenario
from lowsnr_sensor.simulator import fluctuating
from lowsnr_sensor.simulator import simulate_frames
import numpy as np
import numpy.typing as npt


def track(
    frames: npt.ArrayLike, detector: str | None = None, snr_db: float | None = None, *,
    period_s: float = 1.0, condition: str = 'auto', false_alarm_prob: float | None = None,
    seed: int = 0, settings: Mapping[str, Any] | None = None, progress: bool | None = None,
) -> results.Tracking:
    """
    Detect and track the objects in a sequence of frames.

    Parameters
    ----------
    frames : (K, rows, cols) array_like
        Frames of a camera, or white noise plus objects.
    detector
        Name of the detector; by default ``'auto'`` for frames that are conditioned and ``'sdt'``
        for others.
    snr_db
        SNR that the detector is designed for, ``10 log10(I^2 / sigma^2)`` of a cell [dB]; by
        default 6.
    period_s
        Time from a frame to the next [s].  It is the unit of time of the results alone: objects
        are taken to move as much from frame to frame whatever the period is.
    condition
        Whether background, uneven noise and motion of the camera are removed first: ``'on'``,
        ``'off'`` (the noise is white, and its standard deviation is ``sensor.noise_std``, 1
        unless set), or ``'auto'``: ``'on'`` for integers and ``'off'`` for floating point.
    false_alarm_prob
        Share of empty frames with any declaration; by default 0.01.  Without conditioning the
        threshold is calibrated by simulation, at the first call with these settings; with it the
        threshold of ``cdt``, ``sdt``, ``cusum``, ``bank`` and ``auto`` is learned from the
        earlier frames of the sequence.
    seed
        Root seed of the random numbers of detector and tracker.
    settings
        Settings by full name, such as ``{'sdt.max_iterations': 8, 'tracker.particles': 4000}``;
        the names and defaults are those of the files in ``lowsnr/config``.
    progress
        Whether progress is shown on stderr; by default where that is a terminal.

    Returns
    -------
    Tracking
        Detections and confirmed tracks as tables, and every setting that was chosen.

    Raises
    ------
    ValueError
        One line that names the argument and the remedy.

    """
    array, chain = planned(frames, condition, Options(
        detector=detector, snr_db=snr_db, period_s=period_s, false_alarm_prob=false_alarm_prob,
        seed=seed, settings=settings))
    detected, tracks = run(array, chain, is_shown(progress), tracked=True)
    return results.Tracking(tracks=tracks, **detected)


def detect(
    frames: npt.ArrayLike, detector: str | None = None, snr_db: float | None = None, *,
    period_s: float = 1.0, condition: str = 'auto', false_alarm_prob: float | None = None,
    seed: int = 0, settings: Mapping[str, Any] | None = None, progress: bool | None = None,
) -> results.Detections:
    """
    Detect the objects in a sequence of frames, without tracking them.

    Parameters, errors and detections are those of :func:`track`.
    """
    array, chain = planned(frames, condition, Options(
        detector=detector, snr_db=snr_db, period_s=period_s, false_alarm_prob=false_alarm_prob,
        seed=seed, settings=settings))
    return results.Detections(**run(array, chain, is_shown(progress), tracked=False)[0])


def condition(
    frames: npt.ArrayLike, *, settings: Mapping[str, Any] | None = None,
    progress: bool | None = None,
) -> results.ConditionedFrames:
    """
    Turn frames of a camera into white noise of standard deviation one, plus objects.

    Parameters
    ----------
    frames : (K, rows, cols) array_like
        Frames as recorded; NaN is a pixel without a value.
    settings
        Settings of the conditioner, such as ``{'conditioner.binning': 1}``.
    progress
        As for :func:`track`.

    Raises
    ------
    ValueError
        One line that names the argument and the remedy.

    """
    array, chain = planned(frames, 'on', Options(settings=settings))
    assert chain.conditioner is not None
    cells, maps, events = np.empty((len(array), *chain.shape), np.float32), [], {}
    with shown_progress('conditioning', len(array), 'frames', is_shown(progress)) as advance:
        for k, (output, where) in enumerate(
                conditioned(chain.conditioner, array, array.shape[1:])):
            cells[k] = output.cells
            maps.append(where)
            if output.event:
                events[k] = output.event
            advance(1)
    return results.ConditionedFrames(cells=cells, maps=tuple(maps), events=events)


def simulate(
    scenario: str | Path = 'example4', *, snr_db: float | None = None, seed: int = 0,
    settings: Mapping[str, Any] | None = None,
) -> results.Simulation:
    """
    Simulate the frames of a scenario, eqs. (2) and (3), byte for byte as the sensor node does.

    Parameters
    ----------
    scenario
        Name of a file in ``lowsnr/config/scenarios`` without ``.yaml``, or a path.
    snr_db
        SNR of the objects [dB]; by default that of the scenario.
    seed
        Root seed of noise and random motion.
    settings
        Settings of the sensor, such as ``{'sensor.noise.model': 'student_t'}``; they are those of
        the detector too: ``'all.sensor.noise.model'``.

    Raises
    ------
    ValueError
        One line that names the scenario, or the argument, and what is allowed.

    """
    found = load_scenario(find_scenario(str(scenario), CONFIG / 'scenarios'))
    sensor = sensor_of(found.snr_db if snr_db is None else snr_db, settings)
    seed = checked('seed', seed)
    period_s, cell, drawn = sensor.frame_period_s, sensor.cell_size_m, stream(seed, 'truth')
    truth = fluctuating(found.truth(period_s, cell, drawn), sensor, drawn)
    return results.Simulation(
        frames=simulate_frames(truth, sensor, found.shape, stream(seed, 'noise')),
        truth=results.truth_table(truth, sensor.snr_db, period_s, cell), snr_db=sensor.snr_db)


def calibrate(
    shape: tuple[int, int], detector: str | None = None, snr_db: float | None = None, *,
    false_alarm_prob: float | None = None, settings: Mapping[str, Any] | None = None,
    progress: bool | None = None,
) -> Calibration:
    """
    Simulate the threshold of a detector for frames of white noise, and keep it for later calls.

    Parameters
    ----------
    shape
        Rows and columns of a frame.
    detector, snr_db, false_alarm_prob, settings, progress
        As for :func:`track`.

    Returns
    -------
    Calibration
        The threshold [nat] with its 95 % interval and the runs that it rests on.

    Raises
    ------
    ValueError
        One line that names the argument and what is allowed.

    """
    chain = plan_chain((1, *checked_shape(shape)), False, Options(
        detector=detector, snr_db=snr_db, false_alarm_prob=false_alarm_prob, settings=settings))
    with shown_calibration(chain, is_shown(progress)) as advance:
        return calibrated(
            chain.detector, chain.operating.false_alarm_prob, chain.shape, progress=advance,
            warn=LOG.warning)


def confirm(
    frames: npt.ArrayLike, false_tracks: float, detector: str | None = None,
    snr_db: float | None = None, *, condition: str = 'auto',
    false_alarm_prob: float | None = None, seed: int = 0,
    settings: Mapping[str, Any] | None = None, progress: bool | None = None,
) -> RecordedConfirmation:
    """
    Return when to confirm tracks for a rate of false tracks, by frames without objects.

    ``track(frames, **confirm(empty, 0.001).arguments)`` confirms about one false track in a
    thousand frames like those of ``empty``.

    Parameters
    ----------
    frames : (K, rows, cols) array_like
        Frames of the same camera without objects; an object would count as a false track.
    false_tracks
        False tracks a frame, in (0, 1).
    detector, snr_db, condition, false_alarm_prob, seed, settings, progress
        As for :func:`track`.

    Returns
    -------
    RecordedConfirmation
        The existence probability of confirmation with its interval, and arguments of `track`.

    Raises
    ------
    ValueError
        One line that names the argument and the remedy.

    """
    array, chain = planned(frames, condition, Options(
        detector=detector, snr_db=snr_db, false_alarm_prob=false_alarm_prob, seed=seed,
        settings=settings))
    return confirm_by_frames(array, chain, false_tracks, is_shown(progress))
