# SPDX-License-Identifier: Apache-2.0
"""Confirmation of tracks by a rate of false tracks, on frames that the calibration did not see."""

from dataclasses import replace
import logging
import math
from pathlib import Path
import re

import lowsnr
from lowsnr_bringup.plan import confirmation as module
from lowsnr_bringup.plan import empty_tracks
from lowsnr_bringup.plan.confirmation import confirm_at_rate
from lowsnr_bringup.plan.confirmation import confirmation
from lowsnr_bringup.plan.empty_tracks import idle
from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_bringup.plan.run_plan import plan_run
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.streams import stream
from lowsnr_common.settings.flat_values import changed
from lowsnr_common.settings.flat_values import flat_values
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_detect.calibration.operating_point import calibrated
from lowsnr_detect.detectors.cdt import CDT
from lowsnr_detect.detectors.sdt import SDT
from lowsnr_detect.grid.fixed_lag import answers
from lowsnr_track.pda_mmpf import PdaMmpf
from lowsnr_track.track_management import TrackLife
import numpy as np
import pytest
from scipy.stats import poisson

CONFIG = Path(__file__).resolve().parents[2] / 'config'
SHAPE, FRAMES = (16, 25), 200
SENSOR = SensorModel(snr_db=9.0)
FEW = 300  # particles


@pytest.fixture
def quick(monkeypatch):
    """Let a calibration end after a few false tracks."""
    monkeypatch.setattr(empty_tracks, '_ENOUGH', 20)


def tracker_of(detector, rate):
    return PdaMmpf(
        sensor=SENSOR, rows=SHAPE[0], cols=SHAPE[1], particles=FEW,
        frames_per_detection=detector.frames_per_declaration,
        life=TrackLife(false_tracks=rate))


def published(detector, tracker, runs, seed):
    """Return how many tracks are published in empty frames, frame by frame as by the node."""
    rng, ids = np.random.default_rng(seed), 0
    for _ in range(runs):
        state, seen = tracker.init(), set()
        drawn = (SENSOR.draw_noise(SHAPE, rng) for _ in range(FRAMES))
        for k, declared in enumerate(answers(detector, drawn, rng), start=1):
            state, output = tracker.step(state, declared.estimates(), float(k), rng)
            seen |= {item.id for item in output.confirmed}
        ids += len(seen)
    return ids


@pytest.mark.parametrize('rate', [0.01, pytest.param(0.001, marks=pytest.mark.slow)])
@pytest.mark.parametrize('cls', [SDT, CDT])
def test_false_tracks_come_at_the_asked_rate(cls, rate):
    detector, operating = cls(sensor=SENSOR), DetectionSettings(false_alarm_prob=0.1)
    tracker = tracker_of(detector, rate)
    found = confirmation((detector, operating), tracker, SHAPE)
    assert found.low <= found.probability <= found.high
    assert found.measured == pytest.approx(found.tracks / (found.runs * 200))
    assert abs(found.measured - rate) < 0.4 * rate
    tuned = replace(detector, threshold=calibrated(detector, 0.1, SHAPE).threshold)
    runs = 10 if rate == 0.01 else 40
    count = published(tuned, changed(tracker, found.settings(tracker)), runs, 11)
    # Two counts differ: that of the calibration and this one, of fewer frames.
    expected = rate * runs * FRAMES
    slack = 1.0 + 3.0 / math.sqrt(max(found.tracks, 1))
    assert poisson.ppf(1e-3, expected / slack) <= count <= poisson.ppf(1 - 1e-3, expected * slack)
    assert replace(found) == confirmation((detector, operating), tracker, SHAPE)  # from disk


def test_a_higher_rate_confirms_sooner_and_release_is_never_later(quick):
    detector, operating = CDT(sensor=SENSOR), DetectionSettings(false_alarm_prob=0.1)
    few, many = (confirmation((detector, operating), tracker_of(detector, rate), SHAPE)
                 for rate in (0.001, 0.01))
    assert many.probability < few.probability
    tracker = tracker_of(detector, 0.01)
    life = changed(tracker, many.settings(tracker)).life
    assert life.release_probability == life.confirm_probability == many.probability < 0.3


def test_a_rate_that_is_out_of_reach_confirms_every_track(quick):
    detector, operating = CDT(sensor=SENSOR), DetectionSettings(false_alarm_prob=0.01)
    tracker = tracker_of(detector, 0.5)
    found = confirmation((detector, operating), tracker, SHAPE)
    assert found.probability == tracker.life.delete_probability
    assert found.measured < 0.03


def test_false_tracks_of_a_large_frame_are_in_proportion_to_its_cells(monkeypatch, quick):
    monkeypatch.setattr(module, 'simulated_part', lambda *_: SHAPE)
    detector, operating = CDT(sensor=SENSOR), DetectionSettings(
        operating_point='manual')
    detector = replace(detector, threshold=calibrated(detector, 0.1, SHAPE).threshold)
    tracker = tracker_of(detector, 0.01)
    alone = confirmation((detector, operating), tracker, SHAPE)
    tiled = confirmation(
        (detector, operating), changed(tracker, {'life.false_tracks': 0.04}), (32, 50))
    assert tiled.probability == alone.probability
    assert tiled.measured == pytest.approx(4.0 * alone.measured)
    assert (tiled.shape, tiled.simulated_shape) == ((32, 50), SHAPE)


@pytest.mark.slow
def test_adaptive_thresholds_are_simulated_in_white_noise(quick):
    detector = SDT(sensor=SENSOR)
    found = confirmation(
        (detector, DetectionSettings(operating_point='adaptive', false_alarm_prob=0.1)),
        tracker_of(detector, 0.01), SHAPE)
    matched = confirmation(
        (detector, DetectionSettings(false_alarm_prob=0.1)), tracker_of(detector, 0.01), SHAPE)
    assert abs(math.log(found.probability / matched.probability)) < 1.0
    assert 0.005 < found.measured < 0.02


def test_a_frame_without_tracks_and_detections_is_as_the_tracker_has_it():
    tracker = tracker_of(SDT(sensor=SENSOR), 0.01)
    rng, own = (np.random.default_rng(5) for _ in range(2))
    stepped = skipped = tracker.init()
    for k in (1.0, 2.0, 4.0):
        stepped, _ = tracker.step(stepped, [], k, rng)
        skipped = idle(tracker, skipped, k)
        for name in ('stamp_s', 'frames', 'next_id', 'clutter_density', 'posteriors', 'first_s'):
            assert getattr(stepped, name) == getattr(skipped, name)
        assert len(stepped.tracks) == len(skipped.tracks) == 0
    assert rng.random() == own.random()


def run_of(rate, *more):
    return plan_run(RunOptions(
        detectors=['sdt', 'cdt'], scenario='random', snr_db=9.0, overrides=[
            f'tracker.particles={FEW}', f'tracker.life.false_tracks={rate}',
            'all.false_alarm_prob=0.1', *more]), CONFIG)


def test_a_run_gives_the_result_to_the_trackers_and_the_rate_to_the_evaluator(quick):
    plan, off = run_of(0.01), run_of(0.0)
    before = {path: dict(values) for path, values in off.parameters.items()}
    assert confirm_at_rate(off, pytest.fail) == []
    assert off.parameters == before
    assert 'false_tracks' not in before['/evaluator']
    lines = confirm_at_rate(plan, pytest.fail)
    assert plan.parameters['/evaluator']['false_tracks'] == [0.01, 0.01]
    for name, line in zip(('sdt', 'cdt'), lines, strict=True):
        chosen = plan.parameters[f'/{name}/tracker']['life.confirm_probability']
        assert line.startswith(f'{name}.tracker: ')
        assert f' {chosen:.4g} ' in line
        assert 0.005 < chosen < 0.5


def test_the_library_confirms_as_a_run_does(caplog, quick):
    frames = lowsnr.simulate('random', snr_db=9.0, seed=3).frames
    options = {'snr_db': 9.0, 'false_alarm_prob': 0.1, 'progress': False}
    own = {'tracker.particles': FEW}
    with caplog.at_level(logging.INFO, 'lowsnr'):
        asked = lowsnr.track(
            frames, 'sdt', settings={**own, 'tracker.life.false_tracks': 0.01}, **options)
    chosen = asked.settings['tracker.life.confirm_probability']
    plan = run_of(0.01)
    confirm_at_rate(plan, pytest.fail)
    assert plan.parameters['/sdt/tracker']['life.confirm_probability'] == chosen != 0.5
    assert [line for line in caplog.messages if re.search(r'0\.01 false tracks a frame', line)]
    fixed = lowsnr.track(frames, 'sdt', settings={
        **own, 'tracker.life.confirm_probability': chosen,
        'tracker.life.release_probability': min(chosen, 0.3)}, **options)
    np.testing.assert_array_equal(fixed.tracks.data, asked.tracks.data)


@pytest.mark.parametrize('rate', [-0.1, 1.0, math.nan, 'often'])
def test_a_bad_rate_is_one_line_that_names_it(rate):
    with pytest.raises(ValueError) as caught:
        lowsnr.track(np.zeros((3, 8, 8)), 'sdt', snr_db=9.0, settings={
            'tracker.life.false_tracks': rate})
    assert 'life.false_tracks' in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_frames_of_unknown_size_are_refused():
    detector = CDT(sensor=SENSOR)
    with pytest.raises(ValueError) as caught:
        confirmation((detector, DetectionSettings()), tracker_of(detector, 0.01), (0, 0))
    assert 'life.false_tracks' in str(caught.value)


def test_noise_is_not_that_of_the_threshold():
    thresholds, tracks = (stream(0, 'calibration', run).random(4) for run in (
        0, empty_tracks.FIRST_STREAM))
    assert not set(thresholds) & set(tracks)
    assert flat_values(TrackLife())['false_tracks'] == 0.0
