# SPDX-License-Identifier: Apache-2.0
"""Names that strangers chose are shown in tables and pages, and do nothing there."""

import csv

from lowsnr_eval.report import html_page
from lowsnr_eval.report.table import format_table
from lowsnr_eval.scoring import score_rows
from lowsnr_eval.scoring.frame_scoring import FrameScore
import pytest

HOSTILE = '\x1b[2J\nbringup.py: all is well\u202e'
NO_FIGURES = dict.fromkeys((
    'pd', 'pd_interval', 'pfa_per_frame', 'pfa_interval', 'false_alarms', 'rmse_position_m',
    'first_detection_latency_frames', 'rmse_velocity_mps', 'gospa_m', 'frames_with_object',
    'frames_without_object', 'frames_without_truth', 'declared'))


def test_name_forges_no_line_of_the_table():
    figures = {'detection': NO_FIGURES, 'tracking': NO_FIGURES,
               'latency_ms': {'median': None, 'p99': None},
               'detection_latency_ms': {'median': None, 'p99': None}}
    frames = dict.fromkeys(('published', 'scored', 'unanswered', 'unseen', 'lost'), 0)

    def lines(name):
        return format_table({
            'scenario': name, 'seed': 0, 'frames': frames, 'restarts': {name: 1},
            'detectors': {name: figures}, 'evaluation': {'gate_cells': 1.5}}).split('\n')
    assert len(lines(HOSTILE)) == len(lines('sdt'))
    assert all(line.isprintable() for line in lines(HOSTILE))
    assert r'\x1b[2J\nbringup.py' in '\n'.join(lines(HOSTILE))


def test_page_shows_what_does_not_print():
    page = html_page.page(HOSTILE, [
        html_page.section(HOSTILE, HOSTILE), html_page.table([HOSTILE], [[HOSTILE, 1]]),
        html_page.preformatted(HOSTILE), html_page.folded(HOSTILE, html_page.Markup())])
    assert '\x1b' not in page
    assert '\u202e' not in page
    assert page.count(r'\x1b[2J') == 8


@pytest.mark.parametrize('name', ['=1+1', '+1', '-1', '--', '@SUM(A1)', '\t=1', '-'])
def test_no_id_is_a_formula_of_the_table_and_each_is_read_back(name):
    score = FrameScore(1, 1.0, 'sdt', 'detection', (name, '-2'), None)
    line = score_rows.as_lines([score_rows.frame_row(score)])
    assert all(cell[:1] not in tuple('=+-@\t\r') or not cell
               for cell in next(csv.reader([line.decode()])))
    assert score_rows.frame_score(line) == score
