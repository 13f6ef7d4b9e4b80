"""Curves are kept on disk, checked when they are read, and set operating points."""

from concurrent.futures import ThreadPoolExecutor
import json
import os
import re
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


def spoil_text(text):
    """Return a function that puts a text in place of an entry."""
    return lambda path: path.write_text(text)


def spoil_value(name, value, place=None):
    """Return a function that changes one value, or one item of it, in an entry."""
    def spoil(path):
        found = json.loads(path.read_text())
        if place is None:
            found['record'][name] = value
        else:
            found['record'][name][place] = value
        path.write_text(json.dumps(found))
    return spoil


def shift(path):
    """Set all thresholds of an entry to one that is within an interval as wrong as itself."""
    found = json.loads(path.read_text())
    for name in ('threshold', 'low', 'high'):
        found['record'][name] = [-50.0] * len(found['record'][name])
    path.write_text(json.dumps(found))


SPOILT = {
    **{f'text {text[:12]!r}': spoil_text(text) for text in (
        '', '{"threshold": 3.0', '[]', '{}', '"text"', '\x00', '[' * 100_000, '9' * 5000,
        '{"seal": NaN, "record": {"threshold": NaN}}', '{"seal": 1, "record": 1}')},
    'no text': lambda path: path.write_bytes(b'\xff\xfe'),
    'cut': lambda path: path.write_bytes(path.read_bytes()[:-40]),
    'infinite': spoil_value('threshold', float('inf'), 0),
    'NaN': spoil_value('threshold', float('nan'), 5),
    'not a number': spoil_value('threshold', '3', 0),
    'out of its interval': spoil_value('threshold', -50.0, 5),
    'of another shape': spoil_value('shape', [5, 7]),
    'of other runs': spoil_value('runs', 41),
    'missing': spoil_value('log_odds', None),
    'all -50': shift,
}


@pytest.mark.parametrize('spoil', SPOILT.values(), ids=SPOILT)
def test_entry_that_is_not_as_it_was_written_is_named_and_made_again(tmp_path, spoil):
    found = calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW)
    (path,) = tmp_path.iterdir()
    sound = path.read_text()
    spoil(path)
    with pytest.warns(UserWarning, match=re.escape(str(path))) as warned:
        assert calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW) == found
    assert len(warned) == 1
    assert path.read_text() == sound
    assert list(tmp_path.iterdir()) == [path]


def test_entry_of_another_detector_is_not_used(tmp_path):
    calibrated(SDT(), 0.1, SHAPE, folder=tmp_path, **FEW)
    (other,) = tmp_path.iterdir()
    found = calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW)
    (path,) = set(tmp_path.iterdir()) - {other}
    path.write_text(other.read_text())
    with pytest.warns(UserWarning, match=re.escape(str(path))):
        assert calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW) == found


def test_folder_in_place_of_an_entry_costs_only_time(tmp_path):
    found = calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW)
    (path,) = tmp_path.iterdir()
    path.unlink()
    (path / 'more').mkdir(parents=True)
    with pytest.warns(UserWarning, match=re.escape(str(path))) as warned:
        assert calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW) == found
    assert len(warned) == 2
    assert list(tmp_path.iterdir()) == [path]  # and no draft


def test_dangling_link_in_place_of_an_entry_is_replaced(tmp_path):
    found = calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW)
    (path,) = tmp_path.iterdir()
    sound = path.read_text()
    path.unlink()
    path.symlink_to('nowhere')
    assert calibrated(CDT(), 0.1, SHAPE, folder=tmp_path, **FEW) == found
    assert path.read_text() == sound
    assert not path.is_symlink()


def test_cache_folder_is_the_users_alone(tmp_path):
    calibrated(CDT(), 0.1, SHAPE, folder=tmp_path / 'cache', **FEW)
    assert (tmp_path / 'cache').stat().st_mode & 0o777 == 0o700


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


def test_user_without_a_home_has_a_cache_folder(monkeypatch):
    for name in ('XDG_CACHE_HOME', 'HOME'):
        monkeypatch.delenv(name)
    monkeypatch.setattr(os, 'getuid', lambda: 987_654)  # which the system does not know
    assert str(calibration_cache.default_folder()) == '/.cache/lowsnr'


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
