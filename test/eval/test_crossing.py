# SPDX-License-Identifier: Apache-2.0
"""Identities of the tracks of three crossing objects: kept or swapped, and counted."""

from dataclasses import replace
from pathlib import Path

from lowsnr_common.core.motion import POS
from lowsnr_common.core.records import Estimate
from lowsnr_eval.track_metrics.identity import Identities
from lowsnr_eval.track_metrics.track_frame import TrackFrame
from lowsnr_sensor.scenario import load_scenario
from lowsnr_track.detection_model import DetectionModel
from lowsnr_track.pda_mmpf import PdaMmpf
import numpy as np
import pytest

SCENARIO = Path(__file__).resolve().parents[2] / 'config' / 'scenarios' / 'three_crossing.yaml'
GATE_M, VARIANCE = 1.5, 0.1
BEFORE, CROSSING, AFTER = 12, 23, 30  # all are apart but in the frames between


def followed(seed):
    """Yield the frames of a run: each object is detected with a probability of .95."""
    rng = np.random.default_rng(seed)
    tracker = PdaMmpf(
        rows=20, cols=20, particles=500,
        detection=DetectionModel(probability=0.95, use_scores=False))
    state = tracker.init()
    for k, objects in enumerate(load_scenario(SCENARIO).truth(1.0, 1.0, rng)):
        found = []
        for item in objects:
            if rng.random() < 0.95:
                seen = np.array(item.state)
                seen[POS] += np.sqrt(VARIANCE) * rng.standard_normal(2)
                found.append(Estimate(seen, VARIANCE * np.eye(4), 0.9))
        state, output = tracker.step(state, found, k + 1.0, rng)
        places = [np.reshape([each.state[POS] for each in some], (-1, 2))
                  for some in (objects, output.confirmed)]
        yield TrackFrame(
            k + 1.0, [each.id for each in objects], places[0],
            [each.id for each in output.confirmed], places[1],
            np.array([each.score for each in output.confirmed]))


def nearest(frame):
    """Return the nearest track of each object."""
    return {name: frame.track_ids[n]
            for name, n in zip(frame.object_ids, frame.distance.argmin(axis=1))}


def counted(frames):
    metric = Identities(GATE_M)
    for frame in frames:
        metric.add(frame)
    return metric.figures()


@pytest.fixture(scope='module')
def runs():
    """Return the frames of six runs."""
    return [list(followed(seed)) for seed in range(6)]


def test_tracks_of_objects_that_are_detected_one_by_one_keep_their_objects(runs):
    for frames in runs:
        before, after = nearest(frames[BEFORE]), nearest(frames[AFTER])
        assert len(set(before.values())) == 3
        assert before == after
        assert counted(frames) == {
            'identity_switches': 0, 'identity_swaps': 0, 'track_purity': 1.0}


@pytest.mark.parametrize(('exchanged', 'count'), [
    ({'1': '2', '2': '1'}, 2), ({'1': '2', '2': '3', '3': '1'}, 3)])
def test_tracks_that_change_their_objects_at_the_crossing_are_counted(runs, exchanged, count):
    for frames in runs[:2]:
        assert set(frames[BEFORE].track_ids) == {'1', '2', '3'}
        swapped = frames[:CROSSING] + [
            replace(frame, track_ids=[exchanged.get(name, name) for name in frame.track_ids])
            for frame in frames[CROSSING:]]
        found = counted(swapped)
        assert (found['identity_swaps'], found['identity_switches']) == (count, count)
        assert found['track_purity'] < 0.9
