# SPDX-License-Identifier: Apache-2.0
"""The tails in white noise that are part of the package belong to the statistics that are."""

from dataclasses import replace
import json
from pathlib import Path
import sys

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.streams import stream
from lowsnr_detect.adaptive.known_tails import record_of
from lowsnr_detect.adaptive.known_tails import shipped_records
from lowsnr_detect.adaptive.known_tails import shipped_tail
from lowsnr_detect.adaptive.known_tails import SIDE
from lowsnr_detect.adaptive.known_tails import white_tail
from lowsnr_detect.adaptive.white_tail import simulated_tail
from lowsnr_detect.detectors.auto import Auto
from lowsnr_detect.detectors.cusum import CUSUM
from lowsnr_detect.detectors.velocity_bank import VelocityBank
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / 'benchmarks'))

from ship_tails import tail_cases  # noqa: E402

SHAPE, FRAMES = (17, 19), 4


def test_shipped_tails_are_of_the_statistics_as_they_are_and_no_others_are_kept():
    cases = list(tail_cases())
    tails = [shipped_tail(detector, SIDE, SIDE) for detector in cases]
    assert None not in tails, 'python benchmarks/ship_tails.py makes them'
    kept = sum(
        len(shipped_records(detector))
        for detector in {type(detector): detector for detector in cases}.values())
    assert kept == len(set(tails))


@pytest.fixture
def shipped(tmp_path):
    """Return a detector and a folder that holds its tail."""
    detector = CUSUM()
    text = json.dumps(record_of(detector, *SHAPE, FRAMES))
    (tmp_path / 'cusum.json').write_text(text)
    return detector, tmp_path


def test_tail_is_found_for_its_statistic_and_size_only(shipped):
    detector, folder = shipped
    found = shipped_tail(replace(detector, max_detections=3), *SHAPE, folder)
    expected = simulated_tail(detector, *SHAPE, FRAMES)
    assert found.threshold(323, 0.01) == pytest.approx(expected.threshold(323, 0.01), rel=1e-4)
    assert shipped_tail(detector, *SHAPE[::-1], folder) is None
    assert shipped_tail(replace(detector, drift=0.1), *SHAPE, folder) is None
    assert shipped_tail(replace(detector, thinning_reach=2), *SHAPE, folder) is None
    assert shipped_tail(VelocityBank(), *SHAPE, folder) is None
    louder = replace(detector, sensor=SensorModel(snr_db=detector.sensor.snr_db + 0.1))
    assert shipped_tail(louder, *SHAPE, folder) is None


def test_camera_starts_without_a_simulation(monkeypatch, tmp_path):
    """The tails of ``auto`` at the SNR of the manual's examples, at a camera's frame period."""
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    white_tail.cache_clear()  # what other tests have asked for
    for member in Auto(sensor=SensorModel(snr_db=8.0), threshold=100.0).members:
        white_tail(member, 512, 512)
    assert not list(tmp_path.iterdir())


def test_shipped_threshold_is_exceeded_as_often_as_asked():
    """
    In other noise, the share of the frames of 64 x 64 cells above the threshold for 2 %.

    4,800 frames, whose maxima last a few frames: the share has a standard deviation of about .004
    by the sums over blocks of 60 frames.
    """
    detector, shape = CUSUM(threshold=100.0), (8, SIDE, SIDE)
    threshold = white_tail(detector).threshold(SIDE**2, 0.02)
    rng, state, above = stream(1, 'noise'), detector.init(shape), []
    for number in range(615):
        state, plane = detector.statistic(state, detector.sensor.draw_noise(shape, rng))
        if number >= 15:
            above.append(plane.max(axis=(1, 2)) > threshold)
    blocks = np.reshape(above, (10, 60, 8)).mean(axis=1).ravel()
    error = blocks.std(ddof=1) / np.sqrt(len(blocks))
    assert error < 0.006
    assert abs(blocks.mean() - 0.02) < 3.0 * error
