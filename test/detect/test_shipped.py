# SPDX-License-Identifier: Apache-2.0
"""The calibrations that are part of the package belong to the detectors that are."""

from dataclasses import dataclass
from dataclasses import replace
import json
from pathlib import Path
import sys

from lowsnr_common.settings.declare import setting
from lowsnr_detect.calibration.operating_point import calibrated
from lowsnr_detect.calibration.operating_point import known_curve
from lowsnr_detect.calibration.shipped import record_of
from lowsnr_detect.calibration.shipped import shipped_curve
from lowsnr_detect.calibration.shipped import shipped_records
from lowsnr_detect.calibration.simulated_curve import simulate_curve
from lowsnr_detect.detectors.sdt import SDT
from lowsnr_detect.parts.registry import detector_class
from lowsnr_detect.parts.registry import DETECTORS
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / 'benchmarks'))

from ship_calibrations import shipped_cases  # noqa: E402
from ship_calibrations import WITHOUT  # noqa: E402

detector_class('sdt')  # imports the detectors, which register themselves
SHIPPED = sorted({*DETECTORS} - WITHOUT)
SHAPE = (7, 5)
FEW = {'runs': 40, 'frames': 10}


@pytest.mark.parametrize('name', SHIPPED)
def test_shipped_calibrations_are_of_the_detectors_as_they_are(name):
    missing = [
        detector.sensor.snr_db for detector, shape in shipped_cases(name)
        if shipped_curve(detector, shape) is None]
    assert not missing, f'python benchmarks/ship_calibrations.py --detector {name} makes them'


def test_shipped_curves_are_those_of_full_runs_and_no_others_are_kept():
    for name in SHIPPED:
        cases = [detector for detector, _ in shipped_cases(name)]
        records = shipped_records(cases[0])
        assert len(records) == len(cases) == len({record['settings'] for record in records})
        for record in records:
            curve = record['curve']
            assert (curve['runs'], curve['frames'], curve['seed']) == (1000, 40, 0)
            assert curve['local'] == DETECTORS[name].local
            assert np.all(np.diff(curve['threshold']) <= 0.0)


@pytest.fixture
def shipped(tmp_path):
    """Return a detector and a folder that holds its curve."""
    detector = SDT(upper_threshold=1.0)
    text = json.dumps(record_of(detector, simulate_curve(detector, SHAPE, **FEW)))
    (tmp_path / 'sdt.json').write_text(text)
    return detector, tmp_path


def test_curve_is_found_for_its_settings_and_frame_size_only(shipped):
    detector, folder = shipped
    found = shipped_curve(replace(detector, threshold=3.3), SHAPE, folder)
    expected = simulate_curve(detector, SHAPE, **FEW)
    assert found.threshold == expected.threshold
    assert np.allclose(found.low, expected.low, 1e-4)
    assert shipped_curve(detector, (5, 7), folder) is None
    assert shipped_curve(replace(detector, upper_threshold=1.5), SHAPE, folder) is None


@dataclass(frozen=True, kw_only=True)
class Sdt(SDT):
    """A detector whose statistic is that of SDT times a factor."""

    factor: float = setting(1.0, 'factor of the log-likelihood ratios')

    def step(self, state, frame, rng):
        return super().step(state, self.factor * frame, rng)


@pytest.mark.parametrize(('factor', 'found'), [(1.0, True), (1.01, False)])
def test_curve_of_a_statistic_that_has_changed_is_not_used(tmp_path, factor, found):
    detector = Sdt()
    record = record_of(detector, simulate_curve(detector, SHAPE, **FEW))
    changed = replace(detector, factor=factor)
    # As if the factor were in the code and not in the settings.
    record['settings'] = record_of(changed, simulate_curve(changed, SHAPE, **FEW))['settings']
    (tmp_path / 'sdt.json').write_text(json.dumps(record))
    assert (shipped_curve(changed, SHAPE, tmp_path) is not None) == found


def test_shipped_curve_is_kept_where_it_need_not_be_replayed(tmp_path, monkeypatch):
    (detector, shape), *_ = shipped_cases('sdt')
    found = known_curve(detector, shape, folder=tmp_path)
    monkeypatch.setattr(
        'lowsnr_detect.calibration.operating_point.shipped_curve', lambda *_: None)
    assert known_curve(detector, shape, folder=tmp_path) == found
    assert calibrated(detector, 0.01, shape, folder=tmp_path).threshold == found.at(0.01).threshold


def test_shipped_curve_of_other_options_is_not_used(tmp_path):
    (detector, shape), *_ = shipped_cases('cdt')
    assert known_curve(detector, shape, folder=tmp_path, seed=1) is None
