"""Calibrated thresholds give the wanted false-alarm probability, and are kept."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
import json
import os
import subprocess
import sys

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_detect.calibration import cache as calibration_cache
from lowsnr_detect.calibration.curve import curve_from_record
from lowsnr_detect.calibration.empty_frames import empty_frame_peaks
from lowsnr_detect.calibration.empty_frames import Simulation
from lowsnr_detect.calibration.operating_point import at_operating_point
from lowsnr_detect.calibration.operating_point import calibrate
from lowsnr_detect.calibration.operating_point import calibrated
from lowsnr_detect.calibration.operating_point import logged_progress
from lowsnr_detect.calibration.simulated_curve import simulate_curve
from lowsnr_detect.detectors.cdt import CDT
from lowsnr_detect.detectors.cusum import CUSUM
from lowsnr_detect.detectors.hmm import HMM
from lowsnr_detect.detectors.sdt import SDT
import numpy as np
import pytest

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


def test_posterior_of_the_whole_frame_is_never_taken_from_a_part():
    assert calibrate(HMM(order=0), 0.5, (70, 65), runs=2, frames=1).simulated_shape == (70, 65)


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


@pytest.mark.parametrize('content', ['', '{"threshold": 3.0', '[]', '{}', '"text"', '\x00'])
def test_file_that_is_no_record_is_replaced(tmp_path, content):
    found = calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW)
    (path,) = tmp_path.iterdir()
    sound = path.read_text()
    path.write_text(content)
    assert calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW) == found
    assert path.read_text() == sound


@pytest.mark.parametrize(('name', 'value'), [
    ('runs', 0), ('runs', 40.0), ('runs', True), ('seed', -1), ('frames', None), ('shape', [7]),
    ('shape', [5, 7]), ('simulated_shape', [7, 0]), ('simulated_shape', 7), ('log_odds', []),
    ('threshold', [1.0]), ('threshold', 'high'), ('low', None), ('high', [None])])
def test_record_with_an_impossible_value_is_replaced(tmp_path, name, value):
    found = calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW)
    (path,) = tmp_path.iterdir()
    sound = path.read_text()
    record = {**json.loads(sound), name: value}
    with pytest.raises(ValueError, match=name):
        curve_from_record(record, SHAPE)
    path.write_text(json.dumps(record))
    assert calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW) == found
    assert path.read_text() == sound


@pytest.mark.parametrize(('name', 'place', 'value'), [
    ('log_odds', 3, 99.0), ('threshold', 5, 1e3), ('threshold', 5, float('nan')),
    ('low', 7, 1e3), ('high', 7, -1e3), ('measured_prob', 2, 1.5), ('threshold', 0, '3')])
def test_record_with_one_impossible_point_is_replaced(tmp_path, name, place, value):
    found = calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW)
    (path,) = tmp_path.iterdir()
    record = json.loads(path.read_text())
    record[name][place] = value
    with pytest.raises(ValueError, match=name):
        curve_from_record(record, SHAPE)
    path.write_text(json.dumps(record))
    assert calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW) == found


def test_folder_that_cannot_be_written_is_a_warning(tmp_path):
    (tmp_path / 'file').touch()
    with pytest.warns(UserWarning, match=str(tmp_path / 'file' / 'folder')):
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
