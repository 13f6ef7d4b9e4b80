# SPDX-License-Identifier: Apache-2.0
"""The frames of a whole sequence through a chain, with progress for people."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from contextlib import AbstractContextManager
from contextlib import nullcontext
from dataclasses import replace
import sys
from typing import Any

from lowsnr import results
from lowsnr.chain import DetectorRun
from lowsnr.chain import LOG
from lowsnr.chain import OpenFrame
from lowsnr.chain import prepared
from lowsnr.chain import TrackerRun
from lowsnr.frames import as_frames
from lowsnr.frames import check_conditionable
from lowsnr.frames import check_white
from lowsnr.frames import is_conditioned
from lowsnr.frames import unmasked
from lowsnr.plan import Chain
from lowsnr.plan import Options
from lowsnr.plan import plan_chain
from lowsnr_bringup.plan.confirmation import confirmation
from lowsnr_bringup.plan.sources import MATCHED
from lowsnr_bringup.run.progress import calibration_progress
from lowsnr_bringup.run.progress import is_terminal
from lowsnr_bringup.run.progress import progress
from lowsnr_common.core.records import Estimate
from lowsnr_common.settings.flat_values import changed
from lowsnr_detect.calibration.empty_frames import Progress
import numpy as np
import numpy.typing as npt

# Work that takes less time shows no progress [s].
_DELAY_S = 0.5


def planned(
    frames: npt.ArrayLike, condition: str, options: Options,
) -> tuple[np.ndarray, Chain]:
    """Return the frames and the chain that processes them, all checked."""
    array = as_frames(frames)
    chain = plan_chain(array.shape, is_conditioned(array, condition), options)
    array = unmasked(array)
    if chain.conditioner is not None:
        check_conditionable(array, chain.conditioner.warm_up_frames)
    else:
        check_white(array, chain.detector.sensor)
    return array, chain


def run(
    frames: np.ndarray, chain: Chain, shown: bool, tracked: bool,
) -> tuple[dict[str, Any], results.Table]:
    """Return the fields of :class:`~lowsnr.results.Detections`, and the tracks."""
    detector = started(chain, shown)
    if tracked:
        chain = _confirmed(chain, shown)
    tracker = TrackerRun(chain) if tracked else None
    cell = chain.detector.sensor.cell_size_m
    events: dict[int, str] = {}
    detections, tracks = [], []
    with shown_progress(
            'tracking' if tracked else 'detecting', len(frames), 'frames', shown) as advance:
        for (k, where), found in detected(chain, detector, frames, events, advance):
            when = k, round(k * chain.period_s * 1e9) / 1e9
            detections += [(*when, *results.entry(item, cell)) for item in found]
            if tracker is not None:
                tracks += [(*when, int(item.id), *results.entry(item, cell))
                           for item in tracker.step(found, where, when[1])]
    return {
        'detections': results.Table.of(detections, results.DETECTIONS),
        'detector': chain.name, 'conditioned': chain.conditioner is not None,
        'period_s': chain.period_s, 'seed': chain.seed, 'settings': chain.settings(),
        'thresholds': detector.thresholds(),
        'alarm_rate': detector.alarm_rate(), 'events': events,
    }, results.Table.of(tracks, results.TRACKS)


def started(chain: Chain, shown: bool) -> DetectorRun:
    """Return the detector of a chain, calibrated if it is to be."""
    simulated = chain.operating.operating_point == MATCHED
    with shown_calibration(chain, shown and simulated) as report:
        return DetectorRun(chain, report)


def detected(
    chain: Chain, detector: DetectorRun, frames: np.ndarray, events: dict[int, str],
    advance: Callable[[int], object],
) -> Iterator[tuple[OpenFrame, list[Estimate]]]:
    """Yield the detections of every frame in turn; note what is unusual about frames."""
    for k, (cells, where, event) in enumerate(prepared(chain, frames)):
        if event:
            events[k] = event
        yield from detector.step(k, cells, where)
        advance(1)
    yield from detector.flush()


def _confirmed(chain: Chain, shown: bool) -> Chain:
    """Return the chain whose tracker confirms at the asked rate of false tracks, if any."""
    tracker = chain.tracker
    if not tracker.life.false_tracks:
        return chain
    with shown_calibration(replace(chain, name='tracker'), shown) as report:
        found = confirmation(
            (chain.detector, chain.operating), tracker, chain.shape, progress=report,
            warn=LOG.warning)
    LOG.info('tracker: %s', found)
    return replace(chain, tracker=changed(tracker, found.settings(tracker)))


def is_shown(progress: bool | None) -> bool:
    """Return whether progress is shown: as was asked, else where stderr is a terminal."""
    if sys.stderr is None or getattr(sys.stderr, 'closed', False):  # as without a console
        return False
    return is_terminal() if progress is None else progress


def shown_progress(
    title: str, total: int, unit: str, shown: bool,
) -> AbstractContextManager[Callable[[int], object]]:
    """Return a context whose value is called with the number of parts that were done."""
    if not shown:
        return nullcontext(lambda count: None)
    return progress(title, total, unit, delay_s=_DELAY_S, leave=False)


def shown_calibration(chain: Chain, shown: bool) -> AbstractContextManager[Progress]:
    """Return a context whose value is called with the share of a calibration that was done."""
    if not shown:
        return nullcontext(lambda share: None)
    return calibration_progress(chain.name, chain.shape, chain.detector.sensor.snr_db)
