# SPDX-License-Identifier: Apache-2.0
"""Metrics of tracks from the tables of a run, and the table of the truth that they need."""

from contextlib import closing
import csv
import json
from pathlib import Path
import re

from lowsnr_bringup.run.results_folder import Account
from lowsnr_common.core.records import Estimate
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.scoring.final_summary import summarize
from lowsnr_eval.scoring.final_summary import write_summary
from lowsnr_eval.scoring.run_scoring import RunScorer
from lowsnr_eval.scoring.run_scoring import TRUTH
from lowsnr_eval.track_metrics import run_metrics
from lowsnr_eval.track_metrics.chain_metrics import ChainMetrics
from lowsnr_eval.track_metrics.existence_calibration import ExistenceCalibration
from lowsnr_eval.track_metrics.metrics_table import format_metrics
from lowsnr_eval.track_metrics.metrics_table import short_metrics
from lowsnr_eval.track_metrics.reliability_figure import reliability
from lowsnr_eval.track_metrics.run_metrics import add_track_metrics
from lowsnr_eval.track_metrics.track_frame import TrackFrame
import numpy as np
import pytest

FRAMES = 12
SECOND = 1_000_000_000


def state(x, y, name=''):
    return Estimate(np.array([x, 0.5, y, -0.25]), np.eye(4), 0.75, name)


def scene(k):
    """Return objects and tracks of frame k; two objects without a name, and no track of one."""
    objects = [state(k, 2.0, 'a b'), state(9.0, 9.0), state(9.0, 20.0)]
    return objects, [state(k + 0.5, 2.0, '1'), state(9.25, 9.0, '2')][:1 + (k > 5)]


@pytest.fixture
def run(tmp_path):
    """Return the settings of a run, and its folder with the tables of twelve frames."""
    settings = RunSettings(results=str(tmp_path), scenario='s')
    with closing(RunScorer(settings, Evaluation(), lambda *_: None)) as scorer:
        for k in range(1, FRAMES + 1):
            objects, tracks = scene(k)
            for topic, items in ((TRUTH, objects), ('tracks', tracks)):
                for item in items:
                    scorer.add_state(topic, k * SECOND, item)
                scorer.add_array(topic, k * SECOND, items, 0.0)
            scorer.add_array('detections', k * SECOND, [], 0.0)
            scorer.score()
    return settings, tmp_path


def summary_of(run, faults=()):
    """Return the summary after the metrics were added to it, with these faults."""
    settings, folder = run
    write_summary(folder, summarize(folder, settings, Evaluation(), 0, Account()))
    assert [each.split(': ')[:2] for each in add_track_metrics(folder)] == [
        ['no metrics of tracks', str(each)] for each in faults]
    return json.loads((folder / 'summary.json').read_text())


def metrics_of(run, faults=()):
    return summary_of(run, faults)['detectors']['sdt']['track_metrics']


def directly(frames):
    metrics = ChainMetrics(Evaluation())
    for k in frames:
        objects, tracks = scene(k)
        places = [np.array([each.state[[0, 2]] for each in some]) for some in (objects, tracks)]
        metrics.add(TrackFrame(
            float(k), ['a', 'b', 'c'], places[0], [each.id for each in tracks], places[1],
            np.array([each.score for each in tracks])))
    return metrics.figures()


def drop_line(path, number):
    lines = path.read_text().splitlines(keepends=True)
    path.write_text(''.join(lines[:number] + lines[number + 1:]))


def test_metrics_from_the_tables_are_those_of_the_frames(run):
    found = metrics_of(run)
    assert found['frames'] == FRAMES
    assert found == directly(range(1, FRAMES + 1))
    assert found['siap']['completeness'] == pytest.approx((FRAMES + 7) / (3 * FRAMES))


def test_metrics_that_take_long_show_their_progress(run, capsys, monkeypatch):
    metrics_of(run)
    assert capsys.readouterr().err == ''
    monkeypatch.setattr(run_metrics, '_DELAY_S', 0.0)
    metrics_of(run)
    first, *_, last = capsys.readouterr().err.splitlines()
    assert first == f'metrics of tracks: 0 of {FRAMES} frames'
    assert last.startswith(f'metrics of tracks: {FRAMES} of {FRAMES} frames, ')


def test_truth_is_in_pixels_with_escaped_names(run):
    with (Path(run[1]) / 'truth.csv').open(newline='') as file:
        rows = list(csv.DictReader(file))
    assert rows[3] == {
        'frame': '2', 'stamp_s': '2.000000000', 'id': 'a%20b', 'x': '2', 'y': '2', 'v_x': '0.5',
        'v_y': '-0.25'}
    assert len(rows) == 3 * FRAMES
    assert [row['id'] for row in rows[4:6]] == ['', '']


@pytest.mark.parametrize('name', ['truth.csv', 'tracks.csv'])
def test_chain_that_lost_a_line_on_a_full_disk_has_no_metrics(run, name):
    drop_line(run[1] / name, 3)
    assert metrics_of(run) is None


def test_tables_that_gave_way_show_no_perfect_score(run):
    """Frames without object and track still agree with tables that are empty."""
    with closing(RunScorer(run[0], Evaluation(), lambda *_: None, resumed=True)) as scorer:
        for topic in (TRUTH, 'detections', 'tracks'):
            scorer.add_array(topic, (FRAMES + 1) * SECOND, [], 0.0)
        scorer.score()
        scorer.entries.give_way()
    assert metrics_of(run) is None


def test_numbers_that_no_run_can_have_are_read_back_as_unknown(tmp_path):
    settings = RunSettings(results=str(tmp_path), scenario='s')
    track = Estimate(np.array([2.0, 1e13, 2.0, 0.0]), 1e26 * np.eye(4), 1e300, '1')
    with closing(RunScorer(settings, Evaluation(), lambda *_: None)) as scorer:
        scorer.add_state('tracks', SECOND, track)
        for topic, items in ((TRUTH, [state(2.0, 2.0)]), ('detections', []), ('tracks', [track])):
            scorer.add_array(topic, SECOND, items, 0.0)
        scorer.add_state(TRUTH, SECOND, state(2.0, 2.0))
        scorer.score()
    found = metrics_of((settings, tmp_path))
    assert found['siap']['completeness'] == 1.0
    assert sum(found['existence_calibration']['tracks']) == 0


def test_older_results_without_truth_have_no_metrics(run):
    (run[1] / 'truth.csv').unlink()
    assert metrics_of(run) is None


@pytest.mark.parametrize('name', ['truth.csv', 'tracks.csv'])
@pytest.mark.parametrize('text', ['1,1.0,sdt', '1,1.000000000,,1e300,1,1,1', 'x,,,,,,'])
def test_damaged_table_is_named_and_costs_nothing_but_the_metrics(run, name, text):
    path = run[1] / name
    lines = path.read_text().splitlines()
    path.write_text('\n'.join([lines[0], text, *lines[1:], '']))
    assert metrics_of(run, [path]) is None


def test_table_and_figure_show_the_figures(run):
    summary = summary_of(run)
    found = summary['detectors']['sdt']['track_metrics']
    rows = {row[0]: row[1:] for row in (
        re.split('  +', line) for line in format_metrics(summary).splitlines())}
    assert float(rows['SIAP completeness'][0]) == pytest.approx(
        found['siap']['completeness'], abs=5e-4)
    assert float(rows['OSPA(2) [m]'][0]) == pytest.approx(found['ospa2_m'], abs=5e-4)
    assert rows['identity swaps'] == ['0']
    _, head, own, _ = short_metrics(run[1]).split('\n')[:4]
    assert re.split('  +', head) == [
        'tracks of', 'OSPA(2) [m]', 'GOSPA [m]', 'switches', 'swaps', 'purity']
    name, ospa2, _, switches, swaps, purity = own.split()
    assert (name, switches, swaps, float(purity)) == (
        'sdt', rows['identity switches'][0], '0', pytest.approx(found['track_purity'], abs=5e-3))
    assert float(ospa2) == pytest.approx(found['ospa2_m'], abs=5e-3)
    assert len(head) <= 100
    axes, = reliability(found['existence_calibration']).axes
    points = [line.get_xydata() for line in axes.lines if line.get_marker() == 'o']
    np.testing.assert_allclose(points, [[[0.75, 1.0]]])
    assert [text.get_text() for text in axes.texts] == [str(FRAMES + 7)]
    (run[1] / 'truth.csv').unlink()
    assert format_metrics(summary_of(run)) == short_metrics(run[1]) == ''
    assert reliability(ExistenceCalibration(1.0).figures()) is None
