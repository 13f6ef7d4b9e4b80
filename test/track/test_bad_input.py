# SPDX-License-Identifier: Apache-2.0
"""Unusable stamps and detections: rejected, counted, and without effect on the tracks."""

import time

from lowsnr_track import measurements
from lowsnr_track.pda_mmpf import PdaMmpf
import numpy as np
import pytest
from track.scenes import detection
from track.scenes import everything
from track.scenes import follow


@pytest.fixture
def tracker():
    return PdaMmpf(rows=16, cols=24)


@pytest.mark.parametrize('stamp', [5.0, 4.0, float('nan')])
def test_stamp_that_does_not_advance_is_rejected(tracker, rng, stamp):
    state, _ = tracker.step(tracker.init(), [], 5.0, rng)
    with pytest.raises(ValueError):
        tracker.step(state, [], stamp, rng)


def test_long_gap_drops_all_tracks(tracker, rng):
    state = tracker.init()
    for k in range(1, 8):
        state, output = tracker.step(state, [detection(5 + 0.1 * k, 5)], float(k), rng)
    assert output.confirmed
    state, output = tracker.step(state, [], 1e6, rng)
    assert not everything(output)


def test_unusable_detections_are_counted(tracker, rng):
    bad = [
        detection(np.nan, 3), detection(np.inf, 3), detection(3, 3, score=np.nan),
        detection(3, 3, score=1.5), detection(-0.6, 3), detection(3, 15.5), detection(1e300, 0),
        detection(3, 3), detection(3, 3, score=0.8)]
    _, output = tracker.step(tracker.init(), bad, 1.0, rng)
    assert output.rejected == {
        measurements.NOT_FINITE: 3, measurements.NO_SCORE: 1, measurements.OUTSIDE: 3,
        measurements.DUPLICATE: 1}
    assert len(everything(output)) == 1


def test_after_a_restart_earlier_frames_are_tracked_under_new_ids(tracker, rng):
    state = tracker.init()
    for k in range(101, 109):
        state, before = tracker.step(state, [detection(5 + 0.1 * k % 9, 5)], float(k), rng)
    state, before_restart = tracker.restart(state), state
    assert state.clutter_density == before_restart.clutter_density
    ids = {item.id for item in everything(before)}
    for k in range(1, 9):
        state, after = tracker.step(state, [detection(5 + 0.1 * k, 5)], float(k), rng)
        assert not ids & {item.id for item in everything(after)}
    assert before.confirmed
    assert after.confirmed


@pytest.mark.parametrize('huge', [1e9, 1e30, 1e300])
def test_huge_numbers_leave_other_tracks_finite_in_a_frame_of_unknown_size(rng, huge):
    tracker, state = PdaMmpf(), PdaMmpf().init()
    for k in range(1, 12):
        shown = [detection(5 + 0.1 * k, 5), detection(huge, huge), detection(3, 9, variance=huge)]
        state, output = tracker.step(state, shown, float(k), rng)
        for item in everything(output):
            assert np.isfinite(item.state).all()
            assert np.isfinite(item.cov).all()
    assert output.confirmed


@pytest.mark.parametrize('variance', [np.nan, 0.0, -1.0, np.inf, 1e-9])
def test_covariance_is_never_less_than_rounding(variance):
    measured, rejected = measurements.screen(
        [detection(3, 3, variance=variance)], np.full(2, np.inf), 2.0)
    assert measured.cov[0] == pytest.approx(np.eye(2) * 4 / 12)
    assert not rejected


def test_time_grows_no_faster_than_detections(tracker, rng):
    """Ten times as many detections take at most thirty times as long."""
    spent = {count: min(time_of_flood(tracker, count, rng) for _ in range(3))
             for count in (1000, 10_000)}
    assert spent[10_000] < 30 * spent[1000]


def time_of_flood(tracker, count, rng):
    """Return the CPU time of two frames with ``count`` detections each [s]."""
    state = tracker.init()
    floods = [
        [detection(x, y, score) for x, y, score in rng.uniform([0, 0, 0], [23, 15, 1], (count, 3))]
        for _ in range(2)]
    start = time.process_time()  # of this process alone
    for k, flood in enumerate(floods, start=1):
        state, output = tracker.step(state, flood, float(k), rng)
        assert len(everything(output)) <= tracker.life.max_tracks
    return time.process_time() - start


def test_hundred_empty_frames_delete_every_track(tracker, rng):
    outputs = follow(tracker, [[detection(5, 5), detection(9, 9)]] + [[]] * 100, rng)
    assert not everything(outputs[-1])
