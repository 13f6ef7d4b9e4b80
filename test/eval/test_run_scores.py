# SPDX-License-Identifier: Apache-2.0
"""Scores of many runs at once, against those of one frame after the other."""

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Truth
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_eval.scoring.frame_scoring import compare
from lowsnr_eval.study.run_scores import RunScores
from lowsnr_eval.study.run_scores import score_runs
import numpy as np
import pytest

RUNS, FRAMES, SLOTS = 6, 50, 4


def drawn(rng):
    """Return truth and estimates, some absent, some far, some without velocity."""
    truth = rng.uniform(0.0, 8.0, (RUNS, FRAMES, 4))
    truth[rng.random((RUNS, FRAMES)) < 0.3] = np.nan
    states = rng.uniform(0.0, 8.0, (RUNS, FRAMES, SLOTS, 4))
    states[rng.random((RUNS, FRAMES, SLOTS)) < 0.5] = np.nan
    states[rng.random((RUNS, FRAMES, SLOTS)) < 0.3, 1::2] = np.nan
    return truth, states


def test_scores_are_those_of_single_frames(rng):
    evaluation = Evaluation(sensor=SensorModel(cell_size_m=0.8))
    truth, states = drawn(rng)
    scores = score_runs(truth, states, evaluation)
    for run, k in np.ndindex(RUNS, FRAMES):
        objects = [Truth('a', truth[run, k])] if np.isfinite(truth[run, k, 0]) else []
        found = [Estimate(s, np.eye(4), 0.5) for s in states[run, k] if np.isfinite(s[0])]
        one = compare(objects, found, evaluation)
        assert scores.present[run, k] == len(objects)
        assert scores.declared[run, k] == one.declared
        assert scores.hit[run, k] == len(one.hit_ids)
        assert scores.false_alarms[run, k] == one.false_alarms
        assert scores.gospa_m[run, k] == pytest.approx(one.gospa_m)
        position, velocity = scores.position_error_m[run, k], scores.velocity_error_mps[run, k]
        assert position == pytest.approx(one.rmse_position_m or np.nan, nan_ok=True)
        assert velocity == pytest.approx(one.rmse_velocity_mps or np.nan, nan_ok=True)
    assert scores.hit.any()
    assert scores.false_alarms.any()


def test_no_slots_are_no_declarations(rng):
    truth, states = drawn(rng)
    scores = score_runs(truth, states[:, :, :0], Evaluation())
    assert not scores.declared.any()
    assert not scores.hit.any()
    assert np.allclose(scores.gospa_m, np.where(scores.present, 5.0 / np.sqrt(2.0), 0.0))


def test_joined_parts_are_the_whole(rng):
    truth, states = drawn(rng)
    whole = score_runs(truth, states, Evaluation()).arrays()
    parts = [score_runs(truth[part], states[part], Evaluation())
             for part in (slice(0, 2), slice(2, None))]
    for name, values in RunScores.join(parts).arrays().items():
        assert np.array_equal(values, whole[name], equal_nan=True)
