# SPDX-License-Identifier: Apache-2.0
"""What the tables of detectors share: runs in blocks are runs one by one; gate and intervals."""

from dataclasses import replace
from pathlib import Path
import sys

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_detect.detectors.cdt import CDT
from lowsnr_detect.detectors.sdt import SDT
from lowsnr_eval.study.experiment import simulate_run
from lowsnr_sensor.scenario import load_scenario
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / 'benchmarks'))
from detector_runs import BLOCK  # noqa: E402, I100
from detector_runs import bootstrap  # noqa: E402
from detector_runs import declared  # noqa: E402
from detector_runs import empty_alarms  # noqa: E402
from detector_runs import within_gate  # noqa: E402

SCENARIO = replace(load_scenario(ROOT / 'config' / 'scenarios' / 'random.yaml'), rows=18, cols=21)


def test_runs_in_blocks_are_those_of_a_detector_that_takes_one_after_the_other():
    sensor, runs = SensorModel(snr_db=9.0), BLOCK + 2
    detector = SDT(sensor=sensor, threshold=9.0)
    truth, found, _ = declared(detector, SCENARIO, sensor, runs, 3)
    assert truth.shape == (runs, SCENARIO.frames, 2)
    declarations = 0
    for run in (0, BLOCK - 1, BLOCK, runs - 1):
        states, frames = simulate_run(SCENARIO, sensor, 3, run)
        np.testing.assert_array_equal(truth[run], states[:, ::2])
        memory = detector.init(SCENARIO.shape)
        for k, frame in enumerate(frames):
            memory, answer = detector.step(memory, frame, np.random.default_rng(0))
            places = answer.state[..., ::2]
            np.testing.assert_array_equal(found[run, k], places)
            declarations += np.isfinite(places[:, 0]).sum()
    assert declarations > 50


def test_gate_is_a_disc_about_the_object():
    gate, rng = Evaluation().gate_m, np.random.default_rng(0)
    truth, found = rng.uniform(0, 6, (3, 4, 2)), rng.uniform(0, 6, (3, 4, 5, 2))
    truth[1, 2], found[0, 0, 3] = np.nan, np.nan
    near = within_gate(truth, found)
    assert near.any()
    for index in np.ndindex(near.shape):
        (x, y), (u, v) = truth[index[:2]], found[index]
        assert near[index] == ((x - u)**2 + (y - v)**2 <= gate**2)


def test_share_of_empty_frames_with_an_alarm_is_that_of_the_largest_of_all_cells():
    # P(max of n cells of unit noise > z) = 1 - Phi(z)^n = 0.2, declared above the ratio of z.
    from scipy.stats import norm
    sensor, runs = SensorModel(snr_db=6.0), 400
    z = norm.ppf(0.8**(1.0 / (18 * 21)))
    threshold = float(sensor.log_likelihood_ratio(np.array([[z * sensor.noise_std]]))[0, 0])
    alarms = empty_alarms(CDT(sensor=sensor, threshold=threshold), SCENARIO, runs, 5)
    assert alarms.shape == (runs,)
    assert abs(alarms.mean() - 0.2) < 4.0 * np.sqrt(0.16 / (runs * SCENARIO.frames))


def test_interval_of_a_mean_of_independent_runs_is_that_of_the_normal_distribution():
    values = np.random.default_rng(1).standard_normal(4000)
    low, high = bootstrap(values, 0)
    half = 1.96 * values.std() / np.sqrt(values.size)
    # Each quantile of 1000 draws has a relative error of about 5 %.
    np.testing.assert_allclose([low, high], values.mean() + half * np.array([-1, 1]),
                               atol=0.2 * half)
