# SPDX-License-Identifier: Apache-2.0
"""The errors of filtered and smoothed paths as a table of text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lowsnr_common.settings.text import printable
from lowsnr_eval.report.table import unit_of

_HEADER = ('', 'tracks', 'points', 'position: filtered', 'smoothed', 'velocity: filtered',
           'smoothed', 'NEES')
_LEGEND = """points: frames of tracks with an object within the gate; RMSE in {unit} and {unit}/s;
NEES of the smoothed positions: 2 where their covariances are true."""


def format_errors(errors: Mapping[str, Mapping[str, Any]], evaluation: Mapping[str, Any]) -> str:
    """Return what :func:`write_smoothed` returns as aligned text."""
    unit, size_m = unit_of(evaluation)
    scale = evaluation['sensor.cell_size_m'] / size_m
    table = [_HEADER, *(_row(printable(name), each, scale) for name, each in errors.items())]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = ['  '.join(
        text.rjust(width) if n else text.ljust(width)
        for n, (text, width) in enumerate(zip(row, widths, strict=True))) for row in table]
    left_out = [f'{printable(name)}: {each["left_out"]} points are left out: the motion of the '
                'camera is not known there' for name, each in errors.items() if each['left_out']]
    return '\n'.join(['smoothed paths', '', *lines, '', _LEGEND.format(unit=unit), *left_out])


def _row(name: str, found: Mapping[str, Any], scale: float) -> tuple[str, ...]:
    figures = [None if found[key] is None else found[key] * scale for key in (
        'filtered_rmse_position', 'smoothed_rmse_position', 'filtered_rmse_velocity',
        'smoothed_rmse_velocity')]
    nees = found['nees_position']
    return (
        name, str(found['tracks']), str(found['points']),
        *('-' if value is None else f'{value:.3f}' for value in figures),
        '-' if nees is None else f'{nees:.2f}')
