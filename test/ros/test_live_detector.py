# SPDX-License-Identifier: Apache-2.0
"""Parameters set on running detector nodes, through the services that ``ros2 param`` calls."""

from lowsnr_common.settings.flat_values import changed
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_detect.calibration.operating_point import calibrated
import lowsnr_detect.detectors  # noqa: F401  (has every detector register itself)
from lowsnr_detect.node.detector_node import DetectorNode
from lowsnr_detect.parts.registry import detector_class
from lowsnr_detect.parts.registry import DETECTORS
from node_client import live_names
from node_client import SHAPE
import numpy as np
import pytest

LIVE = {'threshold', 'sensor.snr_db', 'operating_point', 'false_alarm_prob'}


@pytest.fixture
def cdt(started):
    """Return a client of a CDT whose threshold is set by hand: a cell of 8 is above."""
    return started(DetectorNode, 'cdt', operating_point='manual', threshold=20.0, rows=SHAPE[0],
                   cols=SHAPE[1], sensor__snr_db=20.0)


@pytest.fixture
def matched(started):
    """Return a client of an SDT that was calibrated."""
    return started(DetectorNode, 'sdt', rows=SHAPE[0], cols=SHAPE[1], false_alarm_prob=0.1)


@pytest.mark.parametrize('name', sorted(DETECTORS))
def test_live_parameters_are_threshold_probability_and_design_snr(started, name):
    node = started(DetectorNode, name, operating_point='manual').node
    more = {'upper_threshold'} if name == 'sdt' else set()
    assert live_names(node, detector_class(name), DetectionSettings) == LIVE | more


def test_descriptors_say_what_is_allowed(cdt):
    rate, point, size = cdt.describe('false_alarm_prob', 'operating_point', 'max_detections')
    assert (rate.read_only, point.read_only, size.read_only) == (False, False, True)
    assert rate.additional_constraints == 'a number in (0.0, 1.0)'
    span, = rate.floating_point_range
    assert (span.from_value, span.to_value) == (0.0, 1.0)
    assert point.additional_constraints == "one of 'matched', 'adaptive', 'nominal', 'manual'"
    assert size.additional_constraints == 'a whole number in [1, 10000]'


def test_threshold_is_in_force_from_the_next_frame(cdt, log):
    # At 20 dB a cell of 8 has a log ratio of 10 (2 * 8 - 10) / 2 = 30.
    assert cdt.see(8.0, frames=2) == [1, 1]
    assert cdt.set('threshold', 40.0).successful
    assert cdt.see(8.0) == [0]
    assert cdt.set('threshold', 29).successful
    assert cdt.see(8.0) == [1]
    value, = cdt.get('threshold')
    assert (type(value), value) == (float, 29.0)
    assert any('threshold = 40.0' in line and '20.0' in line for line in log)
    assert any('frame 3' in line and 'manual' in line and '40.00 nat' in line for line in log)
    cdt.spin(lambda: cdt.changes() == [('threshold', 40.0), ('threshold', 29.0)])


@pytest.mark.parametrize(('name', 'value', 'names'), [
    ('threshold', float('nan'), {'threshold', 'nan'}),
    ('threshold', 'high', {'threshold', "'high'"}),
    ('threshold', True, {'threshold', 'True'}),
    ('threshold', [1.0], {'threshold'}),
    ('threshold', None, {'threshold', 'None'}),
    ('sensor.snr_db', 80.1, {'sensor.snr_db', '80.1', '[-30.0, 80.0]'}),
    ('false_alarm_prob', 1.0, {'false_alarm_prob', '(0.0, 1.0)'}),
    ('operating_point', 'best', {'operating_point', "'adaptive', 'nominal', 'manual'"}),
    ('false_alarm_prob', 0.1, {'false_alarm_prob', 'operating_point', "'manual'", "'matched'"}),
    ('max_detections', 3, {'max_detections', 'read-only', '--set cdt.max_detections=VALUE'}),
    ('sensor.noise_std', 2.0, {'sensor.noise_std', 'read-only'}),
    ('seed', 2, {'seed', 'read-only'}),
    ('threshhold', 2.0, {'threshhold', 'cdt_detector'}),
    ('operating_point', 'matched', {'operating_point', "'matched'", 'calibrate.py'}),
])
def test_rejected_value_is_named_and_changes_nothing(cdt, name, value, names):
    parameters = sorted(cdt.node.get_parameters_by_prefix(''))
    before = cdt.get(*parameters)
    answer = cdt.set(name, value)
    assert not answer.successful
    assert [each for each in names if each not in answer.reason] == []
    assert '\n' not in answer.reason
    assert cdt.get(*parameters) == before
    assert cdt.see(8.0) == [1]
    assert cdt.changes() == []


def test_several_are_set_together_or_not_at_all(cdt):
    refused = cdt.set_together(threshold=40.0, sensor__snr_db=200.0)
    assert not refused.successful
    assert 'sensor.snr_db' in refused.reason
    assert cdt.get('threshold', 'sensor.snr_db') == [20.0, 20.0]
    assert cdt.see(8.0) == [1]
    # At 18 dB, I = 7.94: 7.94 (2 * 8 - 7.94) / 2 = 32.
    assert cdt.set_together(threshold=31.0, sensor__snr_db=18.0).successful
    assert cdt.get('threshold', 'sensor.snr_db') == [31.0, 18.0]
    assert cdt.see(8.0) == [1]
    assert cdt.set('threshold', 33.0).successful
    assert cdt.see(8.0) == [0]


def test_threshold_keeps_the_paths_and_design_snr_drops_them(started, log):
    sdt = started(DetectorNode, 'sdt', operating_point='manual', threshold=20.0, rows=SHAPE[0],
                  cols=SHAPE[1], sensor__snr_db=6.0)
    # Five frames decide; at 6 dB a cell of 4 has a log ratio of 2 (2 * 4 - 2) / 2 = 6, so 30.
    assert sdt.see(4.0, frames=4) == [0] * 4
    assert sdt.set('threshold', 25.0).successful
    assert sdt.see(4.0) == [1]
    assert sdt.set('sensor.snr_db', 6.1).successful
    assert sdt.see(4.0, frames=5) == [0] * 4 + [1]
    assert [line.rpartition(', ')[2] for line in log if line.startswith('in force')] == [
        'memory kept', 'memory starts empty']


def test_design_snr_is_read_only_where_frames_are_counted_from_the_start(started):
    sdt = started(DetectorNode, 'sdt', operating_point='manual', move_prior=True,
                  destination__probability=0.5, destination__arrival_frame=30)
    answer = sdt.set('sensor.snr_db', 7.0)
    assert not answer.successful
    assert 'sensor.snr_db' in answer.reason
    assert 'destination.probability' in answer.reason


def test_manual_begins_with_the_thresholds_in_force(matched):
    answer = matched.set('threshold', 3.0)
    assert not answer.successful
    assert [name for name in ('threshold', "operating_point is 'matched'", "'manual'")
            if name not in answer.reason] == []
    found = matched.node._work.thresholds()
    assert found['threshold'] > 1.0
    assert matched.set('operating_point', 'manual').successful
    assert matched.get('threshold', 'upper_threshold') == list(found.values())
    assert matched.node._work.thresholds() == found
    assert matched.set_together(operating_point='nominal').successful
    assert matched.set_together(operating_point='manual', threshold=3.0).successful
    # The upper one is that of the nominal test, ln((1 - beta) / alpha).
    assert matched.node._work.thresholds() == {
        'threshold': 3.0, 'upper_threshold': pytest.approx(np.log(0.9999 / 0.01))}


def test_false_alarm_probability_is_a_look_up(matched, monkeypatch):
    # No simulation, and nothing is read from disk: the curve is in memory.
    for name in ('curve', 'known_curve'):
        monkeypatch.delattr(f'lowsnr_detect.node.live_detector.{name}')
    detector, operating = matched.node.live
    for prob in (0.02, 0.3, 0.001):
        assert matched.set('false_alarm_prob', prob).successful
        wanted = calibrated(detector, prob, SHAPE).threshold
        assert matched.node._work.thresholds()['threshold'] == wanted
        assert len(matched.see(frames=2)) == 2


def test_look_up_is_in_force_from_the_next_frame(started, log):
    cdt = started(DetectorNode, 'cdt', rows=SHAPE[0], cols=SHAPE[1], false_alarm_prob=0.01)
    at = {prob: calibrated(cdt.node.live[0], prob, SHAPE).threshold for prob in (0.01, 0.3)}
    sensor = cdt.node.live[0].sensor
    # A cell whose log ratio is between the two thresholds.
    between = sensor.intensity / 2.0 + np.mean(list(at.values())) / sensor.intensity
    assert cdt.see(between, frames=2) == [0, 0]
    assert cdt.set('false_alarm_prob', 0.3).successful
    assert cdt.see(between) == [1]
    force, = [line for line in log if line.startswith('in force')]
    assert all(part in force for part in ('frame 3', 'matched', f'{at[0.3]:.2f} nat'))


@pytest.mark.parametrize('change', [
    {'sensor__snr_db': 7.0}, {'upper_threshold': 9.0},
    {'sensor__snr_db': 7.0, 'false_alarm_prob': 0.2}])
def test_matched_takes_other_settings_once_they_are_calibrated(matched, change):
    names = [name.replace('__', '.') for name in change]
    before, held = matched.get(*names), matched.node._work.thresholds()
    answer = matched.set_together(**change)
    assert not answer.successful
    assert 'calibrate.py --detector sdt' in answer.reason
    assert matched.get(*names) == before
    assert matched.node._work.thresholds() == held
    detector, operating = (
        changed(one, dict(zip(names, change.values()))) for one in matched.node.live)
    found = calibrated(detector, operating.false_alarm_prob, SHAPE)
    assert matched.set_together(**change).successful
    assert matched.node._work.thresholds()['threshold'] == found.threshold
    assert len(matched.see(frames=2)) == 2


def test_back_to_a_calibrated_operating_point_is_a_look_up(matched):
    found = matched.node._work.thresholds()
    for point in ('nominal', 'matched'):
        assert matched.set('operating_point', point).successful
    assert matched.node._work.thresholds() == found


def test_calibration_at_the_start_reports_its_progress(started, log):
    started(DetectorNode, 'cdt', rows=SHAPE[0], cols=SHAPE[1])
    shares = [int(line.split('%')[0].split()[-1]) for line in log if '% done' in line]
    assert len(shares) > 2  # it may end early
    assert shares == sorted(set(shares))
    assert shares[-1] == 100


def test_what_is_set_before_the_first_frame_holds_from_it_on(started):
    cdt = started(DetectorNode, 'cdt', operating_point='manual', threshold=20.0,
                  sensor__snr_db=20.0)
    assert cdt.set('threshold', 40.0).successful
    assert cdt.see(8.0) == [0]
