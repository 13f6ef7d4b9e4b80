# SPDX-License-Identifier: Apache-2.0
"""Curves are kept on disk, checked when they are read, and set operating points."""

from concurrent.futures import ThreadPoolExecutor
import os
import subprocess
import sys

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_detect.calibration import cache as calibration_cache
from lowsnr_detect.calibration.operating_point import at_operating_point
from lowsnr_detect.calibration.operating_point import calibrated
from lowsnr_detect.calibration.operating_point import logged_progress
from lowsnr_detect.calibration.simulated_curve import simulate_curve
from lowsnr_detect.detectors.cdt import CDT
from lowsnr_detect.detectors.sdt import SDT
import numpy as np
import pytest

SHAPE = (7, 5)
FEW = {'runs': 40, 'frames': 10}


def counted(monkeypatch):
    """Count the curves that are simulated."""
    made = []

    def counting(*args, **options):
        made.append(args)
        return simulate_curve(*args, **options)

    monkeypatch.setattr('lowsnr_detect.calibration.operating_point.simulate_curve', counting)
    return made


def test_second_start_finds_the_threshold(tmp_path, monkeypatch):
    made = counted(monkeypatch)
    first, second = (calibrated(SDT(), 0.1, SHAPE, folder=tmp_path, **FEW) for _ in range(2))
    assert first == second
    assert len(made) == 1


def test_another_probability_is_a_look_up(tmp_path, monkeypatch):
    made = counted(monkeypatch)
    found = [calibrated(SDT(), prob, SHAPE, folder=tmp_path, **FEW).threshold
             for prob in (0.01, 0.1, 0.4)]
    assert found[0] > found[1] > found[2]
    assert len(made) == 1


@pytest.mark.parametrize(('detector', 'shape', 'options'), [
    (SDT(radius=2), SHAPE, FEW), (SDT(sensor=SensorModel(blur_m=0.5)), SHAPE, FEW),
    (SDT(), (5, 7), FEW), (SDT(), SHAPE, {**FEW, 'seed': 1}),
    (SDT(), SHAPE, {**FEW, 'frames': 11}), (CDT(), SHAPE, FEW)])
def test_everything_that_the_curve_depends_on_is_in_the_key(
        tmp_path, monkeypatch, detector, shape, options):
    calibrated(SDT(), 0.1, SHAPE, folder=tmp_path, **FEW)
    made = counted(monkeypatch)
    calibrated(detector, 0.1, shape, folder=tmp_path, **options)
    assert len(made) == 1


def test_threshold_itself_is_not_part_of_the_key(tmp_path, monkeypatch):
    calibrated(SDT(), 0.1, SHAPE, folder=tmp_path, **FEW)
    made = counted(monkeypatch)
    calibrated(SDT(threshold=7.0), 0.1, SHAPE, folder=tmp_path, **FEW)
    assert not made


def test_changed_code_calibrates_again(tmp_path, monkeypatch):
    before = calibration_cache.cache_key(SDT, {})
    source = tmp_path / 'sdt.py'
    source.write_text('changed')
    monkeypatch.setattr(calibration_cache.inspect, 'getfile', lambda cls: str(source))
    assert calibration_cache.cache_key(SDT, {}) != before


AT_ONCE = """
import sys
from pathlib import Path
from lowsnr_detect.calibration.operating_point import calibrated
from lowsnr_detect.detectors.sdt import SDT
print(calibrated(SDT(), 0.1, (7, 5), folder=Path(sys.argv[1]), runs=40, frames=10))
"""


def test_processes_that_calibrate_at_once_agree(tmp_path):
    def start(_):
        return subprocess.run(
            [sys.executable, '-c', AT_ONCE, str(tmp_path)], check=True, capture_output=True,
            text=True, timeout=60, env={**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)},
        ).stdout
    with ThreadPoolExecutor(3) as pool:
        printed = set(pool.map(start, range(3)))
    assert len(printed) == 1
    assert [path.suffix for path in tmp_path.iterdir()] == ['.json']


def test_operating_points():
    detector, logged = CDT(threshold=3.3), []
    curve = simulate_curve(detector, SHAPE, **FEW)

    def tuned(point, found=curve):
        operating = DetectionSettings(operating_point=point, false_alarm_prob=0.05)
        return at_operating_point('cdt', detector, operating, found, logged.append)

    assert tuned('manual') is detector
    assert tuned('nominal', None).threshold == pytest.approx(np.log(99.0))
    assert not logged
    assert tuned('matched').threshold == curve.at(0.05).threshold
    assert f'{curve.at(0.05).threshold:.2f} nat' in logged[0]


def test_progress_is_logged_at_every_fifth():
    logged = []
    show = logged_progress('cdt', SHAPE, logged.append)
    for done in np.linspace(0.0, 1.0, 101):
        show(float(done))
    assert [line.split()[-3] for line in logged] == ['0', '20', '40', '60', '80', '100']
