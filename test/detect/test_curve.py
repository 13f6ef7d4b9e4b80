# SPDX-License-Identifier: Apache-2.0
"""The curve gives the threshold for every false-alarm probability."""

from dataclasses import replace

from lowsnr_common.core.measurement import SensorModel
from lowsnr_detect.calibration.effort import frame_s
from lowsnr_detect.calibration.effort import FULL_RUNS
from lowsnr_detect.calibration.effort import most_runs
from lowsnr_detect.calibration.empty_frames import empty_frame_peaks
from lowsnr_detect.calibration.empty_frames import Simulation
from lowsnr_detect.calibration.operating_point import calibrate
from lowsnr_detect.calibration.simulated_curve import simulate_curve
from lowsnr_detect.calibration.threshold_search import is_precise
from lowsnr_detect.detectors.cdt import CDT
from lowsnr_detect.detectors.cusum import CUSUM
from lowsnr_detect.detectors.hmm import HMM
from lowsnr_detect.detectors.sdt import SDT
from lowsnr_detect.detectors.tbd2 import TBD2
import numpy as np
import pytest
from scipy.stats import norm

SHAPE = (7, 5)
FEW = {'runs': 40, 'frames': 10}


def test_threshold_that_acts_on_the_statistic_reproduces_itself():
    # th_2 low enough to close paths: the threshold acts on the statistic it is a quantile of.
    detector = SDT(sensor=SensorModel(snr_db=9.0), max_iterations=4, upper_threshold=1.0)
    found = calibrate(detector, 0.05, SHAPE, runs=400)
    assert found.measured_prob == pytest.approx(0.05, abs=0.005)
    again = calibrate(replace(detector, threshold=found.threshold), 0.05, SHAPE, runs=400, seed=1)
    assert found.interval[0] < again.threshold < found.interval[1]


def test_design_probability_is_the_quantile_of_the_simulated_statistic():
    # The default false-alarm probability keeps its threshold to the bit.
    for detector in (CDT(), SDT(), HMM(order=0)):
        peaks = empty_frame_peaks(replace(detector, threshold=50.0), Simulation(500, 40, SHAPE, 0))
        found = calibrate(detector, 0.01, SHAPE, runs=500)
        finite = peaks[np.isfinite(peaks)]
        assert found.threshold == np.quantile(finite, 1.0 - 0.01 * peaks.size / finite.size)
        assert found.measured_prob == 0.01


@pytest.mark.parametrize('detector', [
    CDT(), SDT(), SDT(upper_threshold=1.0), CUSUM(), CUSUM(headroom=0.5), HMM(order=0)])
def test_curve_gives_the_rate_that_is_asked_for(detector):
    # Direct simulation with each threshold, on noise of its own.
    runs, frames = 500, 20
    curve = simulate_curve(detector, SHAPE, runs=runs, frames=frames)
    for prob in (0.5, 0.2, 0.05, 0.01, 0.003):
        threshold = curve.at(prob).threshold
        peaks = empty_frame_peaks(
            replace(detector, threshold=threshold), Simulation(runs, frames, SHAPE, 1))
        alarms = (peaks > threshold).mean(axis=1)
        # Frames of a run depend on each other, so that the runs are counted; the threshold
        # comes from as many, hence the 2.  Four standard errors, and 3 % of the probability
        # for the interpolation between the thresholds that were simulated.
        error = 4.0 * max(alarms.std(), prob**0.5 / frames**0.5) * np.sqrt(2.0 / runs)
        assert abs(alarms.mean() - prob) < error + 0.03 * prob


def test_curve_falls_and_its_interval_holds_it():
    curve = simulate_curve(CUSUM(headroom=0.5), SHAPE, **FEW)
    assert np.all(np.diff(curve.threshold) <= 0.0)
    assert np.all(np.array(curve.low) <= curve.threshold)
    assert np.all(np.array(curve.high) >= curve.threshold)
    looked_up = [curve.at(prob).threshold for prob in (1e-300, 1e-9, 0.01, 0.02, 0.5, 1 - 1e-9)]
    assert np.all(np.diff(looked_up) <= 0.0)
    assert np.isfinite(looked_up).all()


def test_own_threshold_does_not_matter():
    for detector in (CDT(), SDT(), HMM(order=0)):
        one = simulate_curve(detector, SHAPE, **FEW)
        assert one == simulate_curve(replace(detector, threshold=3.3), SHAPE, **FEW)


def test_more_runs_narrow_the_interval():
    few, many = (calibrate(CDT(), 0.05, SHAPE, runs=runs) for runs in (50, 800))
    assert np.diff(many.interval) < 0.5 * np.diff(few.interval)


def test_probability_out_of_reach_shows_in_the_measured_one():
    # At 30 dB no path of noise survives eight frames, whatever the threshold.
    found = calibrate(SDT(sensor=SensorModel(snr_db=30.0), max_iterations=8), 0.1, SHAPE, **FEW)
    assert found.measured_prob < 0.01
    assert np.isfinite([found.threshold, *found.interval]).all()


@pytest.mark.parametrize('detector', [CDT(), SDT()])
def test_large_frame_from_a_part_of_it(detector):
    part = calibrate(detector, 0.05, (96, 64), runs=60, frames=20)
    whole = calibrate(detector, 0.05, (96, 64), runs=60, frames=20, extrapolate=False, seed=1)
    assert part.simulated_shape == (64, 64)
    assert whole.simulated_shape == (96, 64)
    overlap = min(part.interval[1], whole.interval[1]) - max(part.interval[0], whole.interval[0])
    assert overlap > 0.0


@pytest.mark.parametrize(('shape', 'part'), [
    ((20, 20), (20, 20)), ((500, 4), (500, 4)), ((5000, 4), (1024, 4)), ((4, 5000), (4, 1024)),
    ((100, 200), (64, 64))])
def test_part_of_a_frame_has_its_cells(shape, part):
    assert calibrate(CDT(), 0.5, shape, runs=2, frames=1).simulated_shape == part


@pytest.mark.parametrize(('detector', 'shape', 'part'), [
    (HMM(order=0), (70, 65), (70, 65)), (HMM(order=2), (20, 20), (20, 20)),
    (HMM(order=2), (96, 70), (32, 32)), (TBD2(), (96, 70), (96, 70))])
def test_posterior_is_taken_from_a_part_only_where_the_frame_is_too_costly(detector, shape, part):
    found = simulate_curve(detector, shape, runs=2, frames=40)
    assert found.simulated_shape == part
    # The probabilities are those of the frame, whatever was simulated.
    assert found.at(0.2).threshold == pytest.approx(
        np.interp(np.log(0.25), found.log_odds, found.threshold))
    if part != shape:
        at = found.at(0.2)
        assert at.interval[0] + 0.3 <= at.threshold + 1e-9 <= at.interval[1] - 0.3 + 2e-9


def test_threshold_of_a_posterior_does_not_depend_on_the_size_of_a_large_frame():
    small, large = (
        calibrate(HMM(order=0), 0.1, (side, side), runs=200, frames=20, seed=side)
        for side in (24, 60))
    deviation = [float(np.diff(found.interval)[0]) / 4.0 for found in (small, large)]
    assert abs(small.threshold - large.threshold) < 0.3 + 3.0 * np.hypot(*deviation)


@pytest.mark.parametrize('seed', [0, 1, 2])
def test_runs_end_when_the_rate_of_alarms_is_known(seed):
    # The statistic of CDT grows with the largest cell, whose distribution has closed form.
    detector = CDT(sensor=SensorModel(snr_db=9.0))
    found = calibrate(detector, 0.01, SHAPE, seed=seed)
    assert found.runs < FULL_RUNS
    height = detector.sensor.log_likelihood_ratio(np.array([[0.0, 1.0]]))[0]
    cell = (found.threshold - height[0]) / (height[1] - height[0])
    assert 0.008 < -np.expm1(SHAPE[0] * SHAPE[1] * norm.logcdf(cell)) < 0.012


@pytest.mark.parametrize('alarms', [0.01, 0.1, 1, 10, 200, 800])
def test_runs_go_on_while_there_are_few_alarms(alarms):
    # The number of 200 independent alarms is known to 1.96 / sqrt(200) = 14 %, of ten to 62 %.
    # At less than one the quantile of exponential noise is above all values.
    peaks = np.random.default_rng(0).exponential(size=(1000, 40))
    assert is_precise(peaks, alarms / peaks.size) == (alarms >= 200)


@pytest.mark.parametrize('detector', [SDT(), HMM(order=0)])
def test_rate_on_other_frames_is_the_one_asked_for(detector):
    found = calibrate(detector, 0.01, SHAPE)
    peaks = empty_frame_peaks(
        replace(detector, threshold=found.threshold), Simulation(2000, 40, SHAPE, 1))
    assert 0.008 < np.mean(peaks > found.threshold) < 0.012


def test_effort_follows_from_cells_states_and_particles():
    shape = (20, 20)
    assert frame_s(CDT(), (40, 40)) == 4.0 * frame_s(CDT(), shape)
    assert frame_s(CDT(), shape) < frame_s(HMM(order=1), shape) < frame_s(HMM(order=2), shape)
    assert frame_s(HMM(lag=2), shape) > 2.0 * frame_s(HMM(), shape)
    assert frame_s(TBD2(particles=8000), shape) > 1.5 * frame_s(TBD2(), shape)
    assert most_runs(CDT(), shape, 40) == FULL_RUNS
    assert 40 <= most_runs(TBD2(particles=100_000), shape, 40) < most_runs(TBD2(), shape, 40)


def test_progress_rises_to_one():
    for detector in (CDT(), SDT()):
        reported = []
        calibrate(detector, 0.05, SHAPE, progress=reported.append, **FEW)
        assert reported == sorted(reported)
        assert reported[0] >= 0.0
        assert reported[-1] == 1.0


@pytest.mark.parametrize('prob', [0.0, 1.0, -0.1, float('nan')])
def test_bad_probability_is_named(prob):
    with pytest.raises(ValueError, match='false_alarm_prob'):
        calibrate(CDT(), prob, SHAPE, **FEW)


@pytest.mark.parametrize(('shape', 'options', 'culprit'), [
    ((0, 5), {}, 'rows'), ((5, 0), {}, 'cols'), (SHAPE, {'runs': 1}, 'runs'),
    (SHAPE, {'frames': 0}, 'frames')])
def test_too_few_cells_runs_or_frames_are_named(shape, options, culprit):
    with pytest.raises(ValueError, match=culprit):
        simulate_curve(CDT(), shape, **options)
