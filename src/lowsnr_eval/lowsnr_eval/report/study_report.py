# SPDX-License-Identifier: Apache-2.0
"""The files of a study: summary, curves, figures, and the report with its verdict table."""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from lowsnr_common.settings.flat_values import flat_values
from lowsnr_eval.report import html_page as pages
from lowsnr_eval.report.html_page import Markup
from lowsnr_eval.report.study_figures import draw_all
from lowsnr_eval.report.study_figures import plan_figures
from lowsnr_eval.study import study_results as tables
from lowsnr_eval.study.study import POINTS
from lowsnr_eval.study.study_identity import code_digest
from lowsnr_eval.study.study_results import StudyResults
from lowsnr_eval.study.verdicts import FAILS
from lowsnr_eval.study.verdicts import HOLDS
from lowsnr_eval.study.workers import Workers

REPORT_FILE = 'report.html'
# Headers of the table of figures of merit, by their key in ``summary.json``.
_COLUMNS = {
    'detector': 'detector', 'snr_db': 'SNR [dB]', 'operating_point': 'operating point',
    'level': 'level', 'pd': 'P_D', 'pfa_per_frame': 'P_FA per frame',
    'pfa_empty': 'P_FA without object', 'rmse_position_m': 'RMSE position [m]',
    'rmse_velocity_mps': 'RMSE velocity [m/s]', 'gospa_m': 'GOSPA [m]', 'runs': 'runs'}
_LEGEND = (
    'P_D: share of the frames with the object in which it was hit within the gate. P_FA: share '
    'of the frames of runs without the object that hold any declaration, first of the side '
    'that the claim puts first. Effects are differences of P_D, or of RMSE (the other side '
    'less the first), with a 95 % interval by paired bootstrap over runs; a verdict follows '
    'where the interval does not hold zero and at least 10 runs of both sides have such frames, '
    'or hits; "3 of 500 runs" says that only 3 have. The first line of a claim decides it.')
_POINTS_NOTE = (
    'nominal: the thresholds of the test as designed. matched: thresholds calibrated so that '
    'the same share of empty frames holds a declaration; only these compare detectors fairly. '
    'Tracks are those of the tracker with its shipped settings, at both. P_FA before, during '
    'and after the object differ: the table counts the frames of these runs without the '
    'object, also those just after it has gone.')
_MEASURES = {
    ('detection', 'pd'): 'P_D, detections', ('tracking', 'pd'): 'P_D, tracks',
    ('tracking', 'rmse_position_m'): 'position [m], tracks',
    ('tracking', 'rmse_velocity_mps'): 'velocity [m/s], tracks',
    ('detection', 'time_ms'): 'time [ms]'}
_CLASSES = {HOLDS: 'holds', FAILS: 'fails'}
_HEADERS = ('claim', 'SNR', 'by', 'nominal', 'matched', '')


def write_study(
    results: StudyResults, thresholds: Mapping[str, Any], folder: Path, command: str,
    workers: Workers,
) -> list[dict[str, Any]]:
    """
    Write ``summary.json``, ``curves.csv``, ``timing.json``, figures and ``report.html``.

    Parameters
    ----------
    results
        Results of the whole study, or of the part that is finished.
    thresholds
        Matched thresholds by case and method [nat].
    folder
        Results folder.
    command
        Command that repeats the study.
    workers
        Workers that draw the figures.

    Returns
    -------
    list of dict
        The claims with their verdicts.

    """
    summary = tables.summary(results, thresholds)
    tables.write_json(summary, folder / 'summary.json')
    tables.write_curves(results, folder / 'curves.csv')
    costs = tables.cost_rows(results)
    times = {name: {'detector_ms': 1e3 * detector, 'tracker_ms': 1e3 * tracker}
             for name, (detector, tracker) in tables.median_times(results).items()}
    tables.write_json({'claims': costs, 'chains': times}, folder / 'timing.json')
    plan = plan_figures(results)
    drawn = draw_all(workers, plan)
    (folder / 'figures').mkdir(exist_ok=True)
    for name, (svg, png) in drawn.items():
        (folder / 'figures' / f'{name}.svg').write_text(svg, encoding='utf-8')
        (folder / 'figures' / f'{name}.png').write_bytes(png)
    pictures = [pages.picture(drawn[name][0], caption) for name, (caption, _) in plan.items()]
    rows = [*summary['claims'], *costs]
    text = _report(results, summary, rows, times, pictures, command)
    (folder / REPORT_FILE).write_text(text, encoding='utf-8')
    return rows


def claims_html(rows: Iterable[Mapping[str, Any]]) -> Markup:
    """Return a table of all figures that the claims compare."""
    return pages.table(_HEADERS, [
        [f'{row["claim"]}: {row["sentence"]}' if row['decides'] else '',
         f'{row["snr_db"]:g} dB', _measure(row),
         *(_html_cell(row['operating_points'][point]) for point in POINTS),
         row['turns'] or '']
        for row in rows])


def claims_markdown(rows: Iterable[Mapping[str, Any]]) -> str:
    """Return a Markdown table of the figures that decide the claims."""
    lines = ['| claim | SNR | by | nominal | matched | |', '|---|---|---|---|---|---|']
    for row in rows:
        if row['decides']:
            cells = [
                f'{row["sentence"]} ({row["claim"]})', f'{row["snr_db"]:g} dB', _measure(row),
                *(_markdown_cell(row['operating_points'][point]) for point in POINTS),
                row['turns'] or '']
            lines.append(f'| {" | ".join(cells)} |')
    return '\n'.join(lines) + '\n'


def _report(
    results: StudyResults, summary: Mapping[str, Any], claims: Sequence[Mapping[str, Any]],
    times: Mapping[str, Any], pictures: list[Markup], command: str,
) -> str:
    study = results.study
    description = study.cases[0].scenario.description
    done = f'{summary["runs_done"]} of {study.options.runs} runs'
    return pages.page(f'Example {study.example.number}: {study.example.title}', [
        pages.section(
            'What this is', f'{description[:1].upper()}{description[1:]}.',
            f'{done} at {", ".join(f"{snr:g} dB" for snr in study.snrs_db)}, seed '
            f'{study.options.seed}.' + (
                ' Methods beyond the comparisons of the paper take part in the first '
                f'{study.options.few_runs} runs.'
                if study.options.few_runs < study.options.runs else '')),
        *([pages.section("The paper's claims", claims_html(claims), _LEGEND)] if claims else []),
        pages.section('Figures of merit', _points_table(summary), _POINTS_NOTE),
        pages.section('Figures', *pictures),
        *([] if not times else [pages.section(
            'Time', pages.table(('chain', 'detector [ms a frame]', 'tracker [ms a frame]'), [
                (name, time['detector_ms'], time['tracker_ms']) for name, time in times.items()]),
            'CPU time of one core; it is the only thing here that differs from run to run of '
            'the same seed.')]),
        pages.section('How to run again', pages.preformatted(command), pages.versions(),
                      f'Digest of the code that the numbers come from: {code_digest()}.'),
        pages.section('Settings', *_settings(results), _thresholds(summary))])


def _points_table(summary: Mapping[str, Any]) -> Markup:
    rows = []
    for row in summary['points']:
        empty = row.get('empty_runs', {})
        shares = {'pd': (row['pd'], row['pd_interval']),
                  'pfa_per_frame': (row['pfa_per_frame'], row['pfa_interval']),
                  'pfa_empty': (empty.get('pfa_per_frame'), empty.get('pfa_interval'))}
        rows.append(row | {key: _share(*share) for key, share in shares.items()})
    return pages.table(
        list(_COLUMNS.values()), [[row[key] for key in _COLUMNS] for row in rows])


def _share(value: float | None, interval: Sequence[float] | None) -> str | None:
    if value is None or interval is None:
        return None
    return f'{value:.3f} [{interval[0]:.3f}, {interval[1]:.3f}]'


def _settings(results: StudyResults) -> list[Markup]:
    case = results.study.cases[0]
    parts = [pages.folded(f'{method.label} ({case.snr_db:g} dB)', _values(method.detector))
             for method in case.methods]
    return [*parts, pages.folded('tracker', _values(case.methods[0].tracker)),
            pages.folded('evaluation', _values(case.evaluation))]


def _thresholds(summary: Mapping[str, Any]) -> Markup:
    rows = [(case, label, value) for case, by_label in summary['thresholds_nat'].items()
            for label, value in by_label.items()]
    return pages.folded('matched thresholds [nat]', pages.table(
        ('case', 'detector', 'threshold [nat]'), rows))


def _values(settings: Any) -> Markup:
    return pages.table(('setting', 'value'), [
        (key, str(value)) for key, value in flat_values(settings).items()])


def _measure(row: Mapping[str, Any]) -> str:
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
    """Return the number of runs that contribute, and the false-alarm rates of the sides."""
    rates = [f'{rate:.3f}' for rate in (found['pfa_better'], found['pfa_worse'])
             if rate is not None]
    runs = f'{found["runs"]} runs'
    if found['telling_runs'] < found['runs']:
        runs = f'{found["telling_runs"]} of {runs}'
    return runs + (f', P_FA {" / ".join(rates)}' if rates else '')
