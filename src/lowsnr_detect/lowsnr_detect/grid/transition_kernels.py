# SPDX-License-Identifier: Apache-2.0
"""Loops of the prediction; as in :mod:`lowsnr_detect.parts.path_kernels`, by rows."""

from __future__ import annotations

from lowsnr_common.core.compiled import compiled
import numpy as np


@compiled
def predict(
    planes: np.ndarray, scale: np.ndarray, first_group: np.ndarray, step: np.ndarray,
    first_entry: np.ndarray, source: np.ndarray, prob: np.ndarray, switch: np.ndarray,
    stays: np.ndarray, born: np.ndarray, first: int, last: int, after: np.ndarray,
    mass: np.ndarray,
) -> None:
    """
    Write ``stays T (scale planes) + born`` of the rows from ``first`` to ``last``.

    ``planes`` and ``after`` are (C, B, rows, cols), ``scale`` and ``mass`` (B, rows, cols),
    ``stays`` (B,) and ``born`` (C, B); the rest is as in
    :class:`lowsnr_detect.grid.transitions.Transitions`.
    """
    rows, cols = scale.shape[1:]
    spread, reach = np.empty(cols), np.abs(step).max()
    switches = len(switch) > 1
    mixed = np.empty((len(planes) if switches else 0, 1, rows, cols))
    for run in range(len(scale)):
        before, at = planes, run
        if switches:
            _switch(planes, switch, run, max(first - reach, 0), min(last + reach, rows), mixed)
            before, at = mixed, 0
        for row in range(first, last):
            mass[run, row] = 0.0
            for kind in range(len(planes)):
                moved = after[kind, run, row]
                moved[:] = 0.0
                for group in range(first_group[kind], first_group[kind + 1]):
                    origin = row - step[group, 0]
                    if 0 <= origin < rows:
                        _gather(
                            before, source, prob, first_entry[group], first_entry[group + 1], at,
                            origin, spread)
                        _shift(spread, scale[run, origin], step[group, 1], moved)
                _add_births(moved, stays[run], born[kind, run], mass[run, row])


@compiled
def _switch(
    planes: np.ndarray, switch: np.ndarray, run: int, first: int, last: int, mixed: np.ndarray,
) -> None:
    """Write the mass (C, 1, rows, cols) of the rows of a run after the modes have switched."""
    kinds = len(planes) // len(switch)
    for kind in range(len(planes)):
        mode, rest = divmod(kind, kinds)
        for row in range(first, last):
            into, here = mixed[kind, 0, row], planes[rest, run, row]
            for col in range(len(into)):
                into[col] = switch[0, mode] * here[col]
            for before in range(1, len(switch)):
                here, weight = planes[before * kinds + rest, run, row], switch[before, mode]
                for col in range(len(into)):
                    into[col] += weight * here[col]


@compiled
def _gather(
    planes: np.ndarray, source: np.ndarray, prob: np.ndarray, first: int, last: int, run: int,
    row: int, spread: np.ndarray,
) -> None:
    """Write the mass of a group in a row."""
    here, weight = planes[source[first], run, row], prob[first]
    for col in range(len(spread)):
        spread[col] = weight * here[col]
    for entry in range(first + 1, last):
        here, weight = planes[source[entry], run, row], prob[entry]
        for col in range(len(spread)):
            spread[col] += weight * here[col]


@compiled
def _shift(spread: np.ndarray, scale: np.ndarray, step: int, moved: np.ndarray) -> None:
    """Add a row times the factors of its points, shifted by ``step`` columns."""
    size = len(moved) - abs(step)
    start = max(-step, 0)
    here, factor, into = spread[start:], scale[start:], moved[max(step, 0):]
    for col in range(size):
        into[col] += here[col] * factor[col]


@compiled
def _add_births(moved: np.ndarray, stays: float, born: float, mass: np.ndarray) -> None:
    """Finish a row of a class, and add it to the sum over the classes."""
    for col in range(len(moved)):
        value = moved[col] * stays + born
        moved[col] = value
        mass[col] += value


@compiled
def expect(
    values: np.ndarray, first_group: np.ndarray, step: np.ndarray, first_entry: np.ndarray,
    source: np.ndarray, prob: np.ndarray, switch: np.ndarray, first: int, last: int,
    before: np.ndarray,
) -> None:
    """
    Write the expectation of a value after the step, of the rows from ``first`` to ``last``.

    ``values`` and ``before`` are (C, B, rows, cols); a value outside the frame is zero.
    """
    count, runs, rows, cols = values.shape
    mixed = np.empty((count, cols))
    for run in range(runs):
        for row in range(first, last):
            into = before[:, run, row]
            into[:] = 0.0
            for kind in range(count):
                for group in range(first_group[kind], first_group[kind + 1]):
                    target = row + step[group, 0]
                    if 0 <= target < rows:
                        _scatter(
                            values[kind, run, target], source, prob, first_entry[group],
                            first_entry[group + 1], step[group, 1], into)
            if len(switch) > 1:
                mixed[:] = into
                _unswitch(mixed, switch, into)


@compiled
def _scatter(
    here: np.ndarray, source: np.ndarray, prob: np.ndarray, first: int, last: int, step: int,
    into: np.ndarray,
) -> None:
    """Add a row after a step to the rows (C, cols) of the classes before it."""
    size = len(here) - abs(step)
    value = here[max(step, 0):]
    for entry in range(first, last):
        row, weight = into[source[entry], max(-step, 0):], prob[entry]
        for col in range(size):
            row[col] += weight * value[col]


@compiled
def _unswitch(mixed: np.ndarray, switch: np.ndarray, into: np.ndarray) -> None:
    """Write the expectations (C, cols) before the modes switch, of those after it."""
    kinds = len(mixed) // len(switch)
    into[:] = 0.0
    for kind in range(len(mixed)):
        mode, rest = divmod(kind, kinds)
        for after in range(len(switch)):
            weight, here, row = switch[mode, after], mixed[after * kinds + rest], into[kind]
            for col in range(len(row)):
                row[col] += weight * here[col]
