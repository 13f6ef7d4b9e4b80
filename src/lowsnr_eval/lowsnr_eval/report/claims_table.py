"""The table of claims, for the report and as Markdown."""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping
from html import escape
from typing import Any

from lowsnr_eval.report import html_page as pages
from lowsnr_eval.report.html_page import Markup
from lowsnr_eval.study.study import POINTS
from lowsnr_eval.study.verdicts import FAILS
from lowsnr_eval.study.verdicts import HOLDS

_MEASURES = {
    ('detection', 'pd'): 'P_D, detections', ('tracking', 'pd'): 'P_D, tracks',
    ('tracking', 'rmse_position_m'): 'position [m], tracks',
    ('tracking', 'rmse_velocity_mps'): 'velocity [m/s], tracks',
    ('detection', 'time_ms'): 'time [ms]'}
_CLASSES = {HOLDS: 'holds', FAILS: 'fails'}
_HEADERS = ('claim', 'SNR', 'by', 'nominal', 'matched', '')


def claims_html(rows: Iterable[Mapping[str, Any]]) -> Markup:
    """Return the table with every figure that was compared."""
    return pages.table(_HEADERS, [
        [f'{row["claim"]}: {row["sentence"]}' if row['decides'] else '',
         f'{row["snr_db"]:g} dB', _what(row),
         *(_html_cell(row['operating_points'][point]) for point in POINTS),
         row['turns'] or '']
        for row in rows])


def claims_markdown(rows: Iterable[Mapping[str, Any]]) -> str:
    """Return the figures that decide the claims, as a Markdown table."""
    lines = ['| claim | SNR | by | nominal | matched | |', '|---|---|---|---|---|---|']
    for row in rows:
        if row['decides']:
            cells = [
                f'{row["sentence"]} ({row["claim"]})', f'{row["snr_db"]:g} dB', _what(row),
                *(_markdown_cell(row['operating_points'][point]) for point in POINTS),
                row['turns'] or '']
            lines.append(f'| {" | ".join(cells)} |')
    return '\n'.join(lines) + '\n'


def _what(row: Mapping[str, Any]) -> str:
    measure = _MEASURES[row['level'], row['measure']]
    return measure if row['reading'] == 'higher P_D' else f'{measure}: {row["reading"]}'


def _html_cell(found: Mapping[str, Any]) -> Markup:
    style = _CLASSES.get(found['verdict'], 'open')
    return Markup(
        f'<span class="{style}">{escape(found["verdict"])}</span><br><span class="figures">'
        f'{escape(_effect(found))}<br>{escape(_basis(found))}</span>')


def _markdown_cell(found: Mapping[str, Any]) -> str:
    strong = f'**{found["verdict"]}**' if found['verdict'] in _CLASSES else found['verdict']
    return f'{strong} {_effect(found)}; {_basis(found)}'


def _effect(found: Mapping[str, Any]) -> str:
    if found['effect'] is None:
        return 'nothing to compare'
    if found['interval'] is None:
        return f'{found["effect"]:+.3f}'
    low, high = found['interval']
    return f'{found["effect"]:+.3f} [{low:+.3f}, {high:+.3f}]'


def _basis(found: Mapping[str, Any]) -> str:
    """Say how many runs tell something, and how often the sides raised false alarms."""
    rates = [f'{rate:.3f}' for rate in (found['pfa_better'], found['pfa_worse'])
             if rate is not None]
    runs = f'{found["runs"]} runs'
    if found['telling_runs'] < found['runs']:
        runs = f'{found["telling_runs"]} of {runs}'
    return runs + (f', P_FA {" / ".join(rates)}' if rates else '')
