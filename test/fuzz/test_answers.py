# SPDX-License-Identifier: Apache-2.0
"""Detections, tracks and truth with any values pass tracker, scorer and viewer."""

from contextlib import closing
import csv
import json

from fuzz.counting import fuzz
from fuzz.counting import tried
from fuzz.messages import arrays
from fuzz.messages import odometries
from fuzz.messages import stamped
from fuzz.messages import stamps_ns
from fuzz.messages import steps_ns
from fuzz.strategies import names
from fuzz.strategies import numbers
from hypothesis import strategies as st
from lowsnr_bringup.run.results_folder import Account
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Truth
from lowsnr_common.ros.messages import array_to_estimates
from lowsnr_common.ros.messages import array_to_sound_estimates
from lowsnr_common.ros.messages import estimates_to_array
from lowsnr_common.ros.messages import odometry_to_estimate
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_common.settings.node_settings import ViewSettings
from lowsnr_eval.report.overlay import draw
from lowsnr_eval.report.overlay import Scene
from lowsnr_eval.report.overlay import Trails
from lowsnr_eval.report.palette import stretch
from lowsnr_eval.report.table import format_table
from lowsnr_eval.ros.view_messages import scene_to_markers
from lowsnr_eval.scoring.final_summary import missing_frames
from lowsnr_eval.scoring.final_summary import summarize
from lowsnr_eval.scoring.frame_scoring import compare
from lowsnr_eval.scoring.run_scoring import NO_TRUTH
from lowsnr_eval.scoring.run_scoring import RunScorer
from lowsnr_eval.scoring.score_rows import FRAME_COLUMNS
from lowsnr_track.pda_mmpf import PdaMmpf
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.serialization import serialize_message

# Numbers at the end of what floats hold may overflow, where what is made of them is right.
pytestmark = pytest.mark.filterwarnings('ignore::RuntimeWarning')
KNOWN, UNKNOWN = PdaMmpf(particles=50, rows=16, cols=24), PdaMmpf(particles=50)
TOPICS = ('ground_truth', 'detections', 'tracks')
frames = st.tuples(steps_ns, arrays())


@fuzz('detection arrays to the tracker', 540, sequence=st.lists(frames, min_size=1, max_size=4),
      tracker=st.sampled_from([KNOWN, UNKNOWN]), cell=st.sampled_from([1.0, 1e-3, 1e6]))
def test_tracker_answers_every_array(sequence, tracker, cell):
    state, rng, stamp_ns = tracker.init(), np.random.default_rng(0), 10**9
    for step_ns, array in sequence:
        stamp_ns += max(abs(step_ns), 1_000_000)
        entries = tried('', array_to_estimates, array, cell) or []
        state, answer = tracker.step(state, entries, stamp_ns / 1e9, rng)
        assert len(answer.confirmed) + len(answer.tentative) <= tracker.life.max_tracks
        assert len(entries) >= sum(answer.rejected.values())
        for track in (*answer.confirmed, *answer.tentative):
            assert np.isfinite(track.state).all()
            assert 0.0 <= track.score <= 1.0
        serialize_message(estimates_to_array(answer.confirmed, stamped(0), cell))


# Positions and velocities that nodes accept in a message, see array_to_sound_estimates.
believable = numbers.filter(lambda value: not abs(value) > 1e9)


@st.composite
def estimates(draw, values=numbers):
    """Return an estimate of these values."""
    row = st.lists(values, min_size=4, max_size=4)
    return Estimate(
        np.array(draw(row)), np.array([draw(row)] * 4), draw(numbers), draw(names))


@fuzz('estimates to scoring', 600, found=st.lists(estimates(believable), max_size=4),
      truth=st.lists(estimates(believable), max_size=3))
def test_any_estimates_compare_with_any_truth(found, truth):
    compared = compare([Truth(item.id, item.state) for item in truth], found, Evaluation())
    for figure in (compared.rmse_position_m, compared.rmse_velocity_mps, compared.gospa_m):
        assert figure is None or np.isfinite(figure)


received = st.tuples(st.sampled_from(TOPICS), stamps_ns, arrays() | odometries())


@fuzz('arrays and states to the scorer', 360, fed=st.lists(received, min_size=1, max_size=8),
      truth=st.booleans())
def test_scorer_takes_any_input(place, fed, truth):
    for path in place.iterdir():
        path.unlink()
    run = RunSettings(results=str(place), scenario='s', detectors=('sdt',), truth=truth)
    rejected = []
    with closing(RunScorer(run, Evaluation(), lambda *why: rejected.append(why))) as scorer:
        for topic, stamp_ns, item in fed:
            if isinstance(item, Odometry):
                if (state := tried('', odometry_to_estimate, item, 0.0)) is not None:
                    scorer.add_state(topic, stamp_ns, state)
            elif (entries := tried('', array_to_sound_estimates, item, 1.0)) is not None:
                scorer.add_array(topic, stamp_ns, entries, 0.0)
            scorer.score()
        scorer.score(float('inf'))
    summary = summarize(place, run, Evaluation(), 0, Account(scorer.ledger))
    assert format_table(json.loads(json.dumps(summary, allow_nan=False)))
    assert summary['frames']['unseen'] == len(rejected)
    assert len(missing_frames(summary['frames'])) == bool(rejected)  # the account adds up
    with (place / 'frames.csv').open(newline='') as file:
        rows = list(csv.reader(file))
    assert rows[0] == list(FRAME_COLUMNS)
    assert {len(row) for row in rows} == {len(FRAME_COLUMNS)}
    assert all(sentence.isprintable() for sentence, _ in rejected)
    assert {reason for _, reason in rejected} <= {NO_TRUTH}


@fuzz('scenes to viewers', 360, cell=numbers.filter(np.isfinite),
      drawn=st.tuples(*[st.lists(estimates(), max_size=3)] * 3), side=st.sampled_from([1, 20, 60]))
def test_viewer_draws_any_scene(cell, drawn, side):
    greys = stretch(np.linspace(0.0, cell, 24).reshape(6, 4))
    truth, detections, tracks = drawn
    trails, settings = Trails(3), ViewSettings(side=side)
    for shown in (tracks, truth, [*tracks, *truth]):
        scene = Scene(truth, detections, shown, trails.add(shown))
        picture = draw(greys, scene, settings)
        assert picture.shape[2] == 3
        serialize_message(scene_to_markers(scene, (6, 4), stamped(0), settings))
