# SPDX-License-Identifier: Apache-2.0
"""Rows of the kernels: the time of a unit, and the ratio to a reference timed in turn with it."""

from functools import partial

from kernels import Case
from kernels import cases
from kernels import timed
from rows.row import Figure
from rows.row import Measurement


def measurements(seconds: float, rounds: int) -> list[Measurement]:
    """Return the rows, each timed for at least so long and in so many rounds."""
    return [
        Measurement(f'{case.what}, {case.size}, over {case.reference}', goal(case),
                    partial(figure, case, seconds, rounds)) for case in cases()]


def goal(case: Case) -> str:
    """Return the goal of a case as it is shown, '' for none."""
    if case.goal_ns is not None:
        return f'{case.goal_ns:g} ns'
    if case.goal is not None:
        return f'{1 / case.goal:,.0f} times faster' if case.faster else f'ratio {case.goal:g}'
    return ''


def figure(case: Case, seconds: float, rounds: int) -> Figure:
    """Time a case."""
    timing = timed(case, seconds, rounds)
    ratio, unit_ns = timing.subject / timing.reference, 1e9 * timing.subject / case.count
    shown = f'{ratio:.2f}' if ratio > 0.1 else f'1 / {1 / ratio:,.0f}'
    met = None
    if case.goal is not None:
        met = ratio <= case.goal
    if case.goal_ns is not None:
        met = unit_ns <= case.goal_ns
    return Figure(f'{1e3 * timing.subject:.3g} ms, {unit_ns:.3g} ns a {case.unit}, ratio {shown}',
                  met)
