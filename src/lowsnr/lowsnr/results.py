# SPDX-License-Identifier: Apache-2.0
"""What the functions of :mod:`lowsnr` return."""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from typing import Self

from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_common.core.records import AlarmRate
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Truth
import numpy as np

_WHEN = [('frame', np.int64), ('time_s', float)]
_STATE = [(name, float) for name in ('x', 'y', 'v_x', 'v_y')]
_DEVIATIONS = [(name, float) for name in ('sd_x', 'sd_y', 'sd_v_x', 'sd_v_y')]
DETECTIONS = [*_WHEN, *_STATE, *_DEVIATIONS, ('score', float)]
TRACKS = [*_WHEN, ('id', np.int64), *_STATE, *_DEVIATIONS, ('score', float)]
TRUTH = [*_WHEN, ('id', 'U64'), *_STATE, ('snr_db', float)]
_SHOWN = 10  # rows of a table that is printed


class Table(np.recarray[Any, np.dtype[np.void]]):
    """
    A structured array, one row an entry, whose columns are also attributes.

    ``frame`` is the index of the frame in the array, ``time_s`` its time from the first frame
    [s].  ``x`` and ``y`` are a position in pixels of the frame as it was passed in: x along the
    columns, y along the rows, (0, 0) in the middle of the first pixel.  ``v_x`` and ``v_y`` are a
    velocity with respect to the scene [pixels/s]; ``sd_*`` are standard deviations in the same
    units.  What is not known is NaN.
    """

    @classmethod
    def of(cls, rows: Iterable[tuple[Any, ...]], columns: Sequence[tuple[str, Any]]) -> Self:
        """Return the rows as a table that cannot be written to by accident."""
        table = np.array(list(rows), dtype=np.dtype(list(columns))).view(cls)
        table.flags.writeable = False
        return table

    def __str__(self) -> str:
        """Return the first and last rows, with the names of the columns above them."""
        half = _SHOWN // 2
        chosen = range(len(self)) if len(self) <= _SHOWN else (
            *range(half), *range(len(self) - half, len(self)))
        names = self.dtype.names or ()
        lines = [names, *([_text(self[n][name]) for name in names] for n in chosen)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        shown = ['  '.join(f'{each:>{width}}' for each, width in zip(line, widths, strict=True))
                 for line in lines]
        if len(self) > _SHOWN:
            shown.insert(1 + half, f'... {len(self) - 2 * half} rows')
        return '\n'.join(shown)

    def to_pandas(self) -> Any:
        """Return the table as a ``pandas.DataFrame``; pandas must be installed."""
        import pandas
        return pandas.DataFrame({name: self[name] for name in self.dtype.names or ()})


@dataclass(frozen=True, kw_only=True)
class Detections:
    """
    The detections in some frames, and how they were made.

    Parameters
    ----------
    detections
        One row a detection, see :class:`Table`; ``score`` is the probability that it is an
        object.
    detector
        Name of the detector.
    conditioned
        Whether the frames were conditioned.
    period_s
        Time from a frame to the next [s].
    seed
        Root seed of the random numbers.
    settings
        All settings of detector, tracker and conditioner by full name, such as
        ``'sdt.max_iterations'``.
    thresholds
        Thresholds in force after the last frame [nat]; of an adaptive detector the largest.
    alarm_rate
        Share of frames with a false alarm that the thresholds are for, ``asked``, and that an
        adaptive detector measured itself, ``measured``; None where there is no such figure.
    events
        What was unusual about a frame, by its index: ``start``, ``cut`` (another scene), or
        ``flat``, ``saturated`` or ``blank`` (ignored).

    """

    detections: Table
    detector: str
    conditioned: bool
    period_s: float
    seed: int
    settings: Mapping[str, Any]
    thresholds: Mapping[str, float]
    alarm_rate: AlarmRate
    events: Mapping[int, str]

    @property
    def arguments(self) -> dict[str, Any]:
        """Return what repeats the run: ``lowsnr.track(frames, **result.arguments)``."""
        return {
            'detector': self.detector, 'condition': 'on' if self.conditioned else 'off',
            'period_s': self.period_s, 'seed': self.seed, 'settings': dict(self.settings)}


@dataclass(frozen=True, kw_only=True)
class Tracking(Detections):
    """
    The detections and confirmed tracks in some frames, and how they were made.

    Parameters
    ----------
    tracks
        One row a track and frame, see :class:`Table`; ``id`` stays with a track, ``score`` is the
        probability that its object exists.

    """

    tracks: Table


@dataclass(frozen=True, kw_only=True)
class ConditionedFrames:
    """
    Frames of a camera as detectors expect them.

    Parameters
    ----------
    cells : (K, rows // binning, cols // binning) ndarray of float32
        Cells in standard deviations of their noise; zeros where nothing is observed, or the
        background is not known yet.
    maps
        Where the cells of each frame lie in it: ``maps[k].pixels([x, y])`` are the pixels of a
        place in cells.
    events
        As of :class:`Detections`.

    """

    cells: np.ndarray
    maps: tuple[FrameMap, ...]
    events: Mapping[int, str]


@dataclass(frozen=True, kw_only=True)
class Simulation:
    """
    The simulated frames of a scenario, and the truth.

    Parameters
    ----------
    frames : (K, rows, cols) ndarray of float32
        Frames, whose noise has the standard deviation one.
    truth
        One row an object and frame, see :class:`Table`; ``snr_db`` is its own SNR [dB].
    snr_db
        SNR of the scenario [dB].

    """

    frames: np.ndarray
    truth: Table
    snr_db: float


def entry(item: Estimate, cell_size_m: float) -> tuple[float, ...]:
    """Return the columns of an estimate from ``x`` to ``score``."""
    with np.errstate(invalid='ignore'):  # a negative variance has no root
        deviations = np.sqrt(np.diagonal(item.cov))
    columns = [*POS, *VEL]
    values = np.concatenate([item.state[columns], deviations[columns]]) / cell_size_m
    return *values.tolist(), item.score


def truth_table(
    truth: Sequence[Sequence[Truth]], snr_db: float, period_s: float, cell_size_m: float,
) -> Table:
    """Return the objects present in each frame as a table."""
    return Table.of(
        ((k, k * period_s, item.id, *(item.state[[*POS, *VEL]] / cell_size_m).tolist(),
          snr_db + item.snr_offset_db)
         for k, objects in enumerate(truth) for item in objects), TRUTH)


def _text(value: object) -> str:
    return f'{value:.2f}' if isinstance(value, float) else str(value)
