# SPDX-License-Identifier: Apache-2.0
"""
Probability of detection of tracks that are confirmed by a rate of false tracks, behind SDT.

``python benchmarks/track_rate.py --runs 200`` prints a row for each asked rate and for the fixed
threshold: the confirmation, the false tracks a frame in empty frames of another seed, and the
frames 10 to 35 of ``random.yaml`` at 9 dB in which a track is within 1.5 cells of the object.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

from lowsnr_bringup.plan.confirmation import confirmation
from lowsnr_bringup.plan.empty_tracks import RUN_FRAMES
from lowsnr_bringup.plan.empty_tracks import simulate
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.settings.flat_values import changed
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_detect.calibration.operating_point import calibrated
from lowsnr_detect.detectors.sdt import SDT
from lowsnr_detect.parts.cell_detector import resolution_of
from lowsnr_sensor.scenario import load_scenario
from lowsnr_track.detection_model import DetectionModel
from lowsnr_track.pda_mmpf import PdaMmpf
import numpy as np
from scipy.special import expit
from scipy.special import gammaincinv
from tracker_scores import interval
from tracker_sdt import DETECTOR_ALARMS
from tracker_sdt import SCENARIO
from tracker_sdt import SCORED
from tracker_sdt import scored

RATES = (0.01, 0.003, 0.001, 0.0003)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().splitlines()[0])
    parser.add_argument('--runs', type=int, default=200)
    parser.add_argument('--seed', type=int, default=1)
    options = parser.parse_args()
    scenario, sensor = load_scenario(SCENARIO), SensorModel(snr_db=9.0)
    plain = SDT(sensor=sensor)
    operating = DetectionSettings(false_alarm_prob=DETECTOR_ALARMS)
    detector = replace(
        plain, threshold=calibrated(plain, DETECTOR_ALARMS, scenario.shape).threshold)
    fixed = PdaMmpf(
        sensor=sensor, rows=scenario.rows, cols=scenario.cols,
        frames_per_detection=detector.frames_per_declaration,
        detection=DetectionModel(resolution=resolution_of(detector)))
    trackers = {'fixed': fixed}
    for rate in RATES:
        asked = changed(fixed, {'life.false_tracks': rate})
        found = confirmation((plain, operating), asked, scenario.shape)
        print(found, flush=True)
        trackers[f'{rate:g}'] = changed(asked, found.settings(asked))
    runs = simulate(detector, fixed, scenario.shape, min(RATES), options.seed)
    existence, frames = expit(np.concatenate(runs)), len(runs) * RUN_FRAMES
    rng = np.random.default_rng(options.seed)
    with ProcessPoolExecutor(2) as pool:
        for label, tracker in trackers.items():
            at = tracker.life.confirm_probability
            count = int(np.sum(existence >= at))
            low, high = (gammaincinv(count + n, tail) / frames if count + n else 0.0
                         for n, tail in ((0, 0.025), (1, 0.975)))
            hits = [run.hit for run in scored(
                pool, detector, tracker, options.runs, options.seed, True)]
            mean, *bounds = interval(np.array(hits)[:, SCORED].mean(axis=1), rng)
            print(f'{label}: confirm {at:.3f}, {count / frames:.5f} [{low:.5f}, {high:.5f}] false '
                  f'tracks a frame ({frames} frames), P_D {mean:.3f} [{bounds[0]:.3f}, '
                  f'{bounds[1]:.3f}]', flush=True)


if __name__ == '__main__':
    main()
