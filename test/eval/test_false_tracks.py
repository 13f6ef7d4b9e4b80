# SPDX-License-Identifier: Apache-2.0
"""The rate of false tracks of a run, asked and scored."""

from contextlib import closing
import json

from lowsnr_bringup.run.results_folder import Account
from lowsnr_common.core.records import Estimate
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.report.table import false_track_lines
from lowsnr_eval.report.table import format_table
from lowsnr_eval.scoring.final_summary import summarize
from lowsnr_eval.scoring.final_summary import write_summary
from lowsnr_eval.scoring.run_scoring import RunScorer
from lowsnr_eval.scoring.run_scoring import TRUTH
from lowsnr_eval.track_metrics.false_tracks import FalseTracks
from lowsnr_eval.track_metrics.identity import FORGET_AFTER_FRAMES
from lowsnr_eval.track_metrics.run_metrics import add_track_metrics
from lowsnr_eval.track_metrics.track_frame import TrackFrame
import numpy as np
import pytest
from scipy.stats import chi2

# Names of objects and tracks, frame by frame: 'a' and 'b' outlive the object, 'c' and 'd' begin
# after it, and 'c' returns.
FRAMES = (('o', 'a'), ('o', 'ab'), ('', 'abc'), ('', 'c'), ('', 'd'), ('', 'c'))


def frame(k, objects, tracks):
    places = [np.zeros((len(some), 2)) for some in (objects, tracks)]
    return TrackFrame(
        float(k), [*objects], places[0], [*tracks], places[1], np.full(len(tracks), 0.9))


def counted(frames):
    counter = FalseTracks()
    for k, names in enumerate(frames):
        counter.add(frame(k, *names))
    return counter


def test_false_tracks_are_those_that_begin_in_frames_without_an_object():
    found = counted(FRAMES).figures()
    assert (found['tracks'], found['frames'], found['per_frame']) == (2, 4, 0.5)
    assert found['per_frame_interval'] == pytest.approx([
        chi2.ppf(0.025, 4) / 8.0, chi2.ppf(0.975, 6) / 8.0])
    none = counted([('', ''), ('', '')]).figures()
    assert none['per_frame_interval'] == pytest.approx([0.0, -np.log(0.025) / 2.0])
    assert counted([('o', 'a')]).figures() is None


def test_false_tracks_take_bounded_memory():
    counter = FalseTracks()
    for k in range(2 * FORGET_AFTER_FRAMES + 1):
        counter.add(frame(k, [], [str(k)]))
    assert counter.figures()['tracks'] == 2 * FORGET_AFTER_FRAMES + 1
    assert len(counter._last) <= FORGET_AFTER_FRAMES + 1


@pytest.mark.parametrize('asked', [(), (0.25,)])
def test_summary_and_table_have_the_rate_asked_and_scored(tmp_path, asked):
    settings = RunSettings(results=str(tmp_path), scenario='s', false_tracks=asked)
    with closing(RunScorer(settings, Evaluation(), lambda *_: None)) as scorer:
        for k, names in enumerate(FRAMES, start=1):
            for topic, some in zip((TRUTH, 'tracks'), names):
                items = [Estimate(np.zeros(4), np.eye(4), 0.75, name) for name in some]
                for item in items:
                    scorer.add_state(topic, k * 10**9, item)
                scorer.add_array(topic, k * 10**9, items, 0.0)
            scorer.add_array('detections', k * 10**9, [], 0.0)
            scorer.score()
    write_summary(tmp_path, summarize(tmp_path, settings, Evaluation(), 0, Account()))
    assert not ''.join(false_track_lines(tmp_path))
    assert add_track_metrics(tmp_path) == []
    summary = json.loads((tmp_path / 'summary.json').read_text())
    chain = summary['detectors']['sdt']
    assert chain['false_tracks_asked'] == (asked[0] if asked else None)
    assert chain['track_metrics']['false_tracks'] == counted(FRAMES).figures()
    lines = [line for line in format_table(summary).splitlines() if 'false tracks a frame' in line]
    assert len(lines) == len(asked)
    assert ''.join(false_track_lines(tmp_path)).splitlines() == lines
    assert all('asked 0.25, scored 0.5000 [0.0606, 1.8062]' in line for line in lines)
