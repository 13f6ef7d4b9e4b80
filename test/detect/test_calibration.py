"""Calibrated thresholds give the wanted share of false alarms, and are kept."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
import json
import os
import subprocess
import sys

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_detect.calibration import cache as calibration_cache
from lowsnr_detect.calibration.calibration import at_operating_point
from lowsnr_detect.calibration.calibration import calibrate
from lowsnr_detect.calibration.calibration import calibrated
from lowsnr_detect.detectors.cdt import CDT
from lowsnr_detect.detectors.hmm import HMM
from lowsnr_detect.detectors.sdt import SDT
import numpy as np
import pytest

SHAPE = (7, 5)
FEW = {'runs': 40, 'frames': 10}


def test_early_declarations_that_close_paths_are_reckoned_with():
    # th_2 low enough to close paths: the threshold acts on the statistic it is a quantile of.
    detector = SDT(sensor=SensorModel(snr_db=9.0), max_iterations=4, upper_threshold=1.0)
    found = calibrate(detector, 0.05, SHAPE, runs=400)
    assert found.measured_prob == pytest.approx(0.05, abs=0.002)
    again = calibrate(replace(detector, threshold=found.threshold), 0.05, SHAPE, runs=400, seed=1)
    assert found.interval[0] < again.threshold < found.interval[1]


def test_own_threshold_does_not_matter():
    for detector in (CDT(), SDT(), HMM()):
        one = calibrate(detector, 0.05, SHAPE, **FEW)
        assert one == calibrate(replace(detector, threshold=3.3), 0.05, SHAPE, **FEW)


def test_more_runs_narrow_the_interval():
    few, many = (calibrate(CDT(), 0.05, SHAPE, runs=runs) for runs in (50, 800))
    assert np.diff(many.interval) < 0.5 * np.diff(few.interval)


def test_threshold_out_of_reach_is_told_by_the_measured_share():
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


def test_posterior_of_the_whole_frame_is_never_taken_from_a_part():
    assert calibrate(HMM(order=0), 0.5, (70, 65), runs=2, frames=1).simulated_shape == (70, 65)


def test_progress_rises_to_one():
    for detector in (CDT(), SDT()):
        told = []
        calibrate(detector, 0.05, SHAPE, progress=told.append, **FEW)
        assert told == sorted(told)
        assert told[0] >= 0.0
        assert told[-1] == 1.0


@pytest.mark.parametrize(('arguments', 'culprit'), [
    ((0.0, SHAPE), 'false_alarm_prob = 0.0'), ((1.0, SHAPE), 'false_alarm_prob = 1.0'),
    ((0.1, (0, 5)), 'rows = 0'), ((0.1, (5, 0)), 'cols = 0')])
def test_bad_arguments_are_named(arguments, culprit):
    with pytest.raises(ValueError, match=culprit):
        calibrate(CDT(), *arguments)


def test_too_few_runs_or_frames_are_named():
    with pytest.raises(ValueError, match='runs = 1, must be at least 2'):
        calibrate(CDT(), 0.1, SHAPE, runs=1)
    with pytest.raises(ValueError, match='frames = 0'):
        calibrate(CDT(), 0.1, SHAPE, frames=0)


def counted(monkeypatch):
    """Count the calibrations that are made."""
    made = []

    def counting(*args, **options):
        made.append(args)
        return calibrate(*args, **options)

    monkeypatch.setattr('lowsnr_detect.calibration.calibration.calibrate', counting)
    return made


def test_second_start_finds_the_threshold(tmp_path, monkeypatch):
    made = counted(monkeypatch)
    first, second = (calibrated(SDT(), 0.1, SHAPE, folder=tmp_path, **FEW) for _ in range(2))
    assert first == second
    assert len(made) == 1


@pytest.mark.parametrize(('detector', 'prob', 'shape', 'options'), [
    (SDT(radius=2), 0.1, SHAPE, FEW), (SDT(sensor=SensorModel(blur_m=0.5)), 0.1, SHAPE, FEW),
    (SDT(), 0.2, SHAPE, FEW), (SDT(), 0.1, (5, 7), FEW), (SDT(), 0.1, SHAPE, {**FEW, 'seed': 1}),
    (SDT(), 0.1, SHAPE, {**FEW, 'frames': 11}), (CDT(), 0.1, SHAPE, FEW)])
def test_what_the_threshold_depends_on_is_told_apart(
        tmp_path, monkeypatch, detector, prob, shape, options):
    calibrated(SDT(), 0.1, SHAPE, folder=tmp_path, **FEW)
    made = counted(monkeypatch)
    calibrated(detector, prob, shape, folder=tmp_path, **options)
    assert len(made) == 1


def test_threshold_itself_is_not_part_of_the_key(tmp_path, monkeypatch):
    calibrated(SDT(), 0.1, SHAPE, folder=tmp_path, **FEW)
    made = counted(monkeypatch)
    calibrated(SDT(threshold=7.0), 0.1, SHAPE, folder=tmp_path, **FEW)
    assert not made


def test_changed_code_calibrates_anew(tmp_path, monkeypatch):
    before = calibration_cache.cache_key(SDT, {})
    source = tmp_path / 'sdt.py'
    source.write_text('changed')
    monkeypatch.setattr(calibration_cache.inspect, 'getfile', lambda cls: str(source))
    assert calibration_cache.cache_key(SDT, {}) != before


@pytest.mark.parametrize('content', ['', '{"threshold": 3.0', '[]', '{}', '"text"', '\x00'])
def test_damaged_file_is_replaced(tmp_path, content):
    found = calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW)
    (path,) = tmp_path.iterdir()
    path.write_text(content)
    assert calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW) == found
    assert json.loads(path.read_text())['threshold'] == found.threshold


def test_folder_that_cannot_be_written_is_a_warning(tmp_path):
    (tmp_path / 'file').touch()
    with pytest.warns(UserWarning, match='calibration not kept'):
        calibrated(CDT(), 0.1, SHAPE, folder=tmp_path / 'file' / 'folder', **FEW)


def test_default_folder_is_the_users_cache(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    calibrated(CDT(), 0.1, SHAPE, **FEW)
    assert len(list((tmp_path / 'lowsnr').glob('*.json'))) == 1
    monkeypatch.delenv('XDG_CACHE_HOME')
    monkeypatch.setenv('HOME', '/home/somebody')
    assert str(calibration_cache.default_folder()) == '/home/somebody/.cache/lowsnr'


AT_ONCE = """
import sys
from pathlib import Path
from lowsnr_detect.calibration.calibration import calibrated
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


def test_operating_points(tmp_path):
    detector, said = CDT(threshold=3.3), []

    def tuned(point):
        operating = DetectionSettings(operating_point=point, false_alarm_prob=0.05)
        return at_operating_point(
            'cdt', detector, operating, SHAPE, log=said.append, folder=tmp_path)

    assert tuned('manual') is detector
    assert tuned('nominal').threshold == pytest.approx(np.log(99.0))
    assert not said
    matched = tuned('matched')
    assert matched.threshold == calibrate(detector, 0.05, SHAPE).threshold
    assert said[0].startswith('cdt: calibrating to 0.05 false alarms a frame of 5 x 7 cells, 0 %')
    assert 'threshold' in said[-1]
    said.clear()
    assert tuned('matched') == matched
    assert len(said) == 1
