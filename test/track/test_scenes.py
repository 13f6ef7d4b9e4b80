# SPDX-License-Identifier: Apache-2.0
"""Several objects, fast ones, gaps and borders: hits of the whole tracker, over simulated runs."""

from dataclasses import replace

from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_track.detection_model import DetectionModel
from lowsnr_track.pda_mmpf import PdaMmpf
import numpy as np
import pytest
from track.scenes import observed

RUNS = 15
GATE_M = 1.5
EVERY_SECOND = np.arange(1.0, 16.0)
SLOW = PdaMmpf(rows=48, cols=64, particles=1000)
FAST = replace(SLOW, motion=MotionModes(max_speed_mps=4.0))


def straight_path(velocity, start=(5.0, 10.0)):
    return lambda t: np.array(start) + t * np.array(velocity)


def tracked(tracker, paths, times, seed, merged=()):
    """
    Return the ids of the tracks at each object (frames, objects), and the false tracks a frame.

    A path returns a position, or None where there is no object.  In the frames ``merged`` all
    objects are one, in their middle.
    """
    rng, state, ids, false = np.random.default_rng(seed), tracker.init(), [], 0
    for k, t in enumerate(times):
        truth = [path(t) for path in paths]
        present = [place for place in truth if place is not None]
        if k in merged:
            present = [np.mean(present, axis=0)]
        state, output = tracker.step(
            state, observed(present, (tracker.cols, tracker.rows), rng), t, rng)
        near = [{item.id for item in output.confirmed
                 if place is not None and np.hypot(*(item.state[POS] - place)) < GATE_M}
                for place in truth]
        ids.append(near)
        false += len({item.id for item in output.confirmed} - set().union(*near))
    return ids, false / len(times)


def hits(tracker, path, times):
    """Return the proportion of runs with a track at the object in each frame."""
    runs = [tracked(tracker, [path], times, seed)[0] for seed in range(RUNS)]
    return np.array([[bool(near) for near, in run] for run in runs]).mean(axis=0)


@pytest.mark.parametrize('times', [
    pytest.param(EVERY_SECOND, id='every frame'),
    pytest.param(np.array([k for k in range(1, 22) if k % 3], dtype=float), id='lost frames'),
    pytest.param(np.cumsum([1.0, 0.4, 1.8, 0.7, 1.3, 0.5, 1.6, 1.0, 0.6, 1.7, 0.9, 1.2]),
                 id='uneven stamps'),
])
def test_objects_of_three_cells_a_frame_are_followed(times):
    """In .95 to .99 of 25 runs; fewer in these 15 by three standard errors at most."""
    found = hits(FAST, straight_path((2.85, 0.9)), times)
    assert found[4:].mean() > 0.9


@pytest.mark.parametrize(('tracker', 'speed'), [(SLOW, 0.8), (FAST, 3.0)])
def test_tracks_keep_their_ids_over_four_lost_frames(tracker, speed):
    times, kept = np.array([1, 2, 3, 4, 5, 6, 10, 11, 12, 13.0]), []
    for seed in range(RUNS):
        ids, _ = tracked(tracker, [straight_path((speed, 0.3 * speed))], times, seed)
        kept.append(bool(ids[5][0] & ids[-1][0]))
    assert np.mean(kept) > 0.85


def test_objects_that_stop_keep_their_tracks():
    found = hits(SLOW, lambda t: np.array([10.0 + 0.8 * min(t, 12.0), 20.0]), np.arange(1.0, 25.0))
    assert found[5:12].mean() > 0.9
    assert found[12:16].mean() > 0.85  # the turn from 0.8 m/s to none takes some frames
    assert found[16:].mean() > 0.88


def test_objects_that_enter_at_the_border_are_found():
    def enters(t):
        return None if t < 3.0 else np.array([-0.4 + 0.7 * (t - 3.0), 20.0 + 0.2 * t])

    found = hits(SLOW, enters, EVERY_SECOND)
    assert found[6:].mean() > 0.9


@pytest.mark.parametrize(('resolution', 'least_kept', 'most_kept'), [
    (0.0, 0.0, 0.4), (2.5, 0.6, 1.0)])
def test_two_objects_that_merge_for_seven_frames_and_split(resolution, least_kept, most_kept):
    """
    While they are one detection a track follows it; after they split, both have one.

    Of 60 runs, both keep their ids in .10 where a detection is of one track, and in .80 else.
    """
    tracker = replace(SLOW, detection=DetectionModel(resolution=resolution))
    upper, lower = (straight_path((0.6, v), (10.0, 20.0 - 15.0 * v)) for v in (-0.35, 0.35))
    times, followed, swapped, both, kept = np.arange(1.0, 31.0), [], [], [], []
    for seed in range(RUNS):
        ids, _ = tracked(tracker, [upper, lower], times, seed, merged=range(11, 18))
        before, after = ids[9], ids[-5]
        swapped.append(bool(before[0] & after[1] and before[1] & after[0]))
        kept.append(all(first & last for first, last in zip(before, after)))
        followed += [bool(first | second) for first, second in ids[11:18]]
        both += [len(first | second) > 1 for first, second in ids[22:]]
    assert least_kept <= np.mean(kept) <= most_kept
    assert np.mean(swapped) < 0.2
    assert np.mean(followed) > 0.9
    assert np.mean(both) > 0.85


def test_forty_objects_in_a_small_frame_have_a_track_each():
    """An object on 18 x 18 cells, where gates overlap now and then."""
    rng = np.random.default_rng(3)
    start, velocity = rng.uniform(10.0, 104.0, (40, 2)), rng.uniform(-0.5, 0.5, (40, 2))
    tracker = replace(SLOW, rows=114, cols=114, particles=500)
    tracker = replace(tracker, life=replace(tracker.life, max_tracks=200))
    paths = [straight_path(*pair) for pair in zip(velocity, start)]
    ids, false = tracked(tracker, paths, EVERY_SECOND, 4)
    assert np.mean([[bool(near) for near in frame] for frame in ids[6:]]) > 0.93
    assert false < 1.0
