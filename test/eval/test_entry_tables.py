# SPDX-License-Identifier: Apache-2.0
"""``detections.csv`` and ``tracks.csv``: all that was declared, in pixels, with full stamps."""

from collections import Counter
from contextlib import closing
import csv

from lowsnr_common.core.records import Estimate
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.scoring.entry_tables import EntryTables
from lowsnr_eval.scoring.frame_scoring import Answer
from lowsnr_eval.scoring.run_scoring import RunScorer
import numpy as np
import pytest

HEADER = 'frame,stamp_s,detector,id,x,y,v_x,v_y,sd_x,sd_y,sd_v_x,sd_v_y,score'
CELL_M = 2.0
STAMP = 1_700_000_000_123_456_789
# In metres and m/s; the covariance has 4, 9, 0.25 and 1 on its diagonal.
TRACK = Estimate(
    np.array([3.0, 1.0, 5.0, -0.5]),
    np.array([[4.0, 0.1, 0.0, 0.0], [0.1, 0.25, 0.0, 0.0], [0.0, 0.0, 9.0, 0.0],
              [0.0, 0.0, 0.0, 1.0]]), 0.987654321, '7')
POSITION = Estimate(
    np.array([1.0, np.nan, 1.0 / 3.0, np.nan]), np.full((4, 4), np.nan), 0.5)


def lines(path):
    return path.read_text().splitlines()


def test_entries_are_in_pixels_with_deviations_and_full_stamps(tmp_path):
    with closing(EntryTables(tmp_path, CELL_M)) as tables:
        tables.add(4, STAMP, {'sdt': Answer([POSITION], [TRACK]), 'cdt': Answer([], None)})
        tables.add(5, STAMP + 1, {'sdt': Answer(None, []), 'cdt': Answer([POSITION], [])})
    assert lines(tmp_path / 'tracks.csv') == [
        HEADER, '4,1700000000.123456789,sdt,7,1.5,2.5,0.5,-0.25,1,1.5,0.25,0.5,0.987654321']
    assert lines(tmp_path / 'detections.csv') == [
        HEADER, '4,1700000000.123456789,sdt,,0.5,0.166666667,,,,,,,0.5',
        '5,1700000000.123456790,cdt,,0.5,0.166666667,,,,,,,0.5']


def test_what_strangers_send_is_no_formula_and_no_number_that_is_none(tmp_path):
    strange = Estimate(
        np.array([1.0, np.inf, 1.0, 0.0]), -np.eye(4), np.nan, '=1+1,"\n')
    with closing(EntryTables(tmp_path, 1.0)) as tables:
        tables.add(1, 0, {'sdt': Answer([strange], None)})
    (row,) = csv.DictReader(lines(tmp_path / 'detections.csv'))
    assert row['id'] == '%3D1%2B1%2C%22%0A'
    assert [key for key, value in row.items() if value == ''] == [
        'v_x', 'sd_x', 'sd_y', 'sd_v_x', 'sd_v_y', 'score']


def test_tables_hold_what_was_scored_and_nothing_else(tmp_path):
    run = RunSettings(results=str(tmp_path), scenario='s', truth=False)
    with closing(RunScorer(run, Evaluation(), lambda *_: None)) as scorer:
        scorer.add_array('detections', 1, [POSITION], 0.0)
        scorer.add_array('tracks', 1, [], 0.0)
        scorer.add_array('tracks', 2, [POSITION], 0.0)  # its detections do not arrive
        scorer.score()
        scorer.add_array('detections', 3, [POSITION, POSITION], 0.0)
        scorer.score(1.0)
    for level, name in (('detection', 'detections.csv'), ('tracking', 'tracks.csv')):
        declared = {row['frame']: int(row['declared'] or 0) for row in csv.DictReader(
            lines(tmp_path / 'frames.csv')) if row['level'] == level}
        found = Counter(line.partition(',')[0] for line in lines(tmp_path / name)[1:])
        assert found == Counter(declared)
        assert found.total() == {'detection': 3, 'tracking': 1}[level]


def test_damaged_table_is_named_by_the_process_that_continues_it(tmp_path):
    EntryTables(tmp_path, 1.0).close()
    with (tmp_path / 'tracks.csv').open('a') as file:
        file.write('not a number,\n')
    with pytest.raises(ValueError, match=r'tracks\.csv'):
        EntryTables(tmp_path, 1.0, after=3)


def test_process_that_continues_cuts_off_what_was_not_scored(tmp_path):
    whole, broken = tmp_path / 'whole', tmp_path / 'broken'
    for folder, first in ((whole, 5), (broken, 4)):
        folder.mkdir()
        with closing(EntryTables(folder, CELL_M)) as tables:
            for frame in range(1, first):
                tables.add(frame, frame, {'sdt': Answer([POSITION, POSITION], [TRACK])})
    path = broken / 'tracks.csv'
    path.write_bytes(path.read_bytes()[:-9])  # within the line of frame 3
    with closing(EntryTables(broken, CELL_M, after=2)) as tables:
        for frame in (3, 4):
            tables.add(frame, frame, {'sdt': Answer([POSITION, POSITION], [TRACK])})
    for name in ('detections.csv', 'tracks.csv'):
        assert (broken / name).read_bytes() == (whole / name).read_bytes()
