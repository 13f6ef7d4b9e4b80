# SPDX-License-Identifier: Apache-2.0
"""The metrics of tracks in ``summary.json`` as a table of text."""

from __future__ import annotations

from collections.abc import Mapping
import json
from pathlib import Path
from typing import Any

from lowsnr_bringup.run.results_folder import SUMMARY_FILE
from lowsnr_common.settings.text import printable
from lowsnr_eval.report.table import unit_of

_LEGEND = """
OSPA(2): over windows of {window} frames, cutoff {cutoff:g} {unit}, orders 1, mean over frames.
GOSPA^2: its parts, mean over frames.  The others are over all frames.
SIAP: a track is assigned to the nearest object within the gate; error: mean distance.
switch: an object is followed by another track than before; swap: a track goes over to another
object; purity: share of the pairs of each track that have its main object.
-: no such figure."""
_SIAP = (
    ('completeness', 3), ('ambiguity', 3), ('spuriousness', 3),
    ('track_number_changes_per_s', 4), ('longest_segment', 3))


def format_metrics(summary: Mapping[str, Any]) -> str:
    """Return the metrics of tracks of a summary as aligned text; empty where it has none."""
    chains = {name: figures['track_metrics'] for name, figures in summary['detectors'].items()
              if figures.get('track_metrics')}
    if not chains:
        return ''
    unit, size_m = unit_of(summary['evaluation'])
    columns = [_column(each, unit, size_m) for each in chains.values()]
    rows = [['', *map(printable, chains)], *(
        [label, *(column[label] for column in columns)] for label in columns[0])]
    legend = _LEGEND.format(
        window=next(iter(chains.values()))['ospa2_window_frames'], unit=unit,
        cutoff=summary['evaluation']['gospa_cutoff_cells']
        * summary['evaluation']['sensor.cell_size_m'] / size_m)
    lines = _aligned(rows)
    calibration = [_calibration(name, each) for name, each in chains.items()]
    return '\n'.join(['metrics of tracks', '', *lines, legend, '', *calibration])


def short_metrics(folder: Path) -> str:
    """Return the main metrics of tracks in a results folder, a line a chain; empty for none."""
    summary = json.loads((folder / SUMMARY_FILE).read_text('utf-8'))
    unit, size_m = unit_of(summary['evaluation'])
    rows = [['tracks of', f'OSPA(2) [{unit}]', f'GOSPA [{unit}]', 'switches', 'swaps', 'purity']]
    for name, figures in summary['detectors'].items():
        if found := figures.get('track_metrics'):
            rows.append([
                printable(name), _number(found['ospa2_m'], 2, size_m),
                _number(figures['tracking']['gospa_m'], 2, size_m),
                str(found['identity_switches']), str(found['identity_swaps']),
                _number(found['track_purity'], 2)])
    return '\n'.join(['', *_aligned(rows), '', '']) if len(rows) > 1 else ''


def _aligned(rows: list[list[str]]) -> list[str]:
    """Return rows with the first column on the left, the others on the right."""
    widths = [max(map(len, each)) for each in zip(*rows, strict=True)]
    return ['  '.join(
        text.rjust(width) if n else text.ljust(width)
        for n, (text, width) in enumerate(zip(row, widths, strict=True))) for row in rows]


def _column(figures: Mapping[str, Any], unit: str, size_m: float) -> dict[str, str]:
    """Return the figures of a chain as text, by their labels."""
    siap = figures['siap']
    parts = {f'GOSPA^2 {name} [{unit}^2]': _number(value, 3, size_m**2)
             for name, value in figures['gospa_parts_m2'].items()}
    return {
        f'OSPA(2) [{unit}]': _number(figures['ospa2_m'], 3, size_m), **parts,
        **{f'SIAP {name.replace("_per_s", " [1/s]").replace("_", " ")}': _number(
            siap[name], digits) for name, digits in _SIAP},
        f'SIAP position error [{unit}]': _number(siap['position_error_m'], 3, size_m),
        'identity switches': str(figures['identity_switches']),
        'identity swaps': str(figures['identity_swaps']),
        'track purity': _number(figures['track_purity'], 3),
    }


def _calibration(name: str, figures: Mapping[str, Any]) -> str:
    """Return the bins of existence that have tracks, in one line."""
    found = figures['existence_calibration']
    bins = ', '.join(
        f'{stated:.2f} stated {share:.2f} true ({count})' for count, stated, share in zip(
            found['tracks'], found['stated'], found['with_object'], strict=True) if count)
    error = '' if found['error'] is None else f'; mean difference {found["error"]:.3f}'
    return f'{printable(name)}: existence {bins or "of no track"}{error}'


def _number(value: float | None, digits: int, unit: float = 1.0) -> str:
    return '-' if value is None else f'{value / unit:.{digits}f}'
