"""Parameters set on running detector nodes, through the services that ``ros2 param`` calls."""

import threading

from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_detect.calibration.operating_point import at_operating_point
import lowsnr_detect.detectors  # noqa: F401  (has every detector register itself)
from lowsnr_detect.node import live_detector as live_module
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
def test_every_detector_takes_threshold_rate_and_design_snr_and_no_more(started, name):
    node = started(DetectorNode, name, operating_point='manual').node
    more = {'upper_threshold'} if name == 'sdt' else set()
    assert live_names(node, detector_class(name), DetectionSettings) == LIVE | more


def test_descriptors_say_what_is_allowed(cdt):
    rate, point, size = cdt.describe('false_alarm_prob', 'operating_point', 'max_detections')
    assert (rate.read_only, point.read_only, size.read_only) == (False, False, True)
    assert rate.additional_constraints == 'a number in (0.0, 1.0)'
    span, = rate.floating_point_range
    assert (span.from_value, span.to_value) == (0.0, 1.0)
    assert point.additional_constraints == "one of 'matched', 'nominal', 'manual'"
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
    assert 'set threshold = 40.0 (was 20.0)' in log
    assert ('in force from frame 3 on: manual, threshold 40.00 nat, design SNR 20 dB, memory kept'
            in log)
    cdt.spin(lambda: cdt.changes() == [('threshold', 40.0), ('threshold', 29.0)])


@pytest.mark.parametrize(('name', 'value', 'said'), [
    ('threshold', float('nan'), 'threshold = nan, must be a number'),
    ('threshold', 'high', "threshold = 'high', must be a number"),
    ('threshold', True, 'threshold = True, must be a number'),
    ('threshold', [1.0], 'must be a number'),
    ('threshold', None, 'threshold = None, must be a number'),
    ('sensor.snr_db', 80.1, 'sensor.snr_db = 80.1, must be a number in [-30.0, 80.0]'),
    ('false_alarm_prob', 1.0, 'false_alarm_prob = 1.0, must be a number in (0.0, 1.0)'),
    ('operating_point', 'best', "must be one of 'matched', 'nominal', 'manual'"),
    ('false_alarm_prob', 0.1, "false_alarm_prob does nothing while operating_point is 'manual'; "
     "set operating_point to 'matched' first, or with it"),
    ('max_detections', 3, 'max_detections is read-only while cdt_detector runs; set it at the '
     'start: --set cdt.max_detections=VALUE'),
    ('sensor.noise_std', 2.0, 'sensor.noise_std is read-only'),
    ('seed', 2, 'seed is read-only'),
    ('threshhold', 2.0, 'threshhold is not a parameter of cdt_detector'),
])
def test_what_must_not_be_set_is_refused_and_changes_nothing(cdt, name, value, said):
    names = sorted(cdt.node.get_parameters_by_prefix(''))
    before = cdt.get(*names)
    answer = cdt.set(name, value)
    assert not answer.successful
    assert said in answer.reason
    assert '\n' not in answer.reason
    assert cdt.get(*names) == before
    assert cdt.see(8.0) == [1]
    assert cdt.changes() == []


def test_several_are_set_together_or_not_at_all(cdt):
    refused = cdt.set_together(threshold=40.0, sensor__snr_db=200.0)
    assert (refused.successful, refused.reason[:14]) == (False, 'sensor.snr_db ')
    assert cdt.get('threshold', 'sensor.snr_db') == [20.0, 20.0]
    assert cdt.see(8.0) == [1]
    # At 18 dB, I = 7.94: 7.94 (2 * 8 - 7.94) / 2 = 32.
    assert cdt.set_together(threshold=31.0, sensor__snr_db=18.0).successful
    assert cdt.get('threshold', 'sensor.snr_db') == [31.0, 18.0]
    assert cdt.see(8.0) == [1]
    assert cdt.set('threshold', 33.0).successful
    assert cdt.see(8.0) == [0]


def test_threshold_keeps_the_paths_and_design_snr_begins_anew(started, log):
    sdt = started(DetectorNode, 'sdt', operating_point='manual', threshold=20.0, rows=SHAPE[0],
                  cols=SHAPE[1], sensor__snr_db=6.0)
    # Five frames decide; at 6 dB a cell of 4 has a log ratio of 2 (2 * 4 - 2) / 2 = 6, so 30.
    assert sdt.see(4.0, frames=4) == [0] * 4
    assert sdt.set('threshold', 25.0).successful
    assert sdt.see(4.0) == [1]
    assert sdt.set('sensor.snr_db', 6.1).successful
    assert sdt.see(4.0, frames=5) == [0] * 4 + [1]
    assert [line.rpartition(', ')[2] for line in log if line.startswith('in force')] == [
        'memory kept', 'memory begins anew']


def test_design_snr_is_refused_where_frames_are_counted_from_the_start(started):
    sdt = started(DetectorNode, 'sdt', operating_point='manual', move_prior=True,
                  destination__probability=0.5, destination__arrival_frame=30)
    answer = sdt.set('sensor.snr_db', 7.0)
    assert not answer.successful
    assert 'sensor.snr_db is read-only where destination.probability is above 0' in answer.reason


def test_hand_set_threshold_is_refused_when_calibrated_and_begins_with_what_is_in_force(matched):
    answer = matched.set('threshold', 3.0)
    assert not answer.successful
    assert "threshold does nothing while operating_point is 'matched'" in answer.reason
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


@pytest.fixture
def go(monkeypatch):
    """Return an event that calibrations wait for; those at the start of a node do not."""
    event = threading.Event()

    def waiting(*arguments, check=None, **options):
        while check and not event.wait(0.01):
            check()
        return at_operating_point(*arguments, check=check, **options)

    monkeypatch.setattr(live_module, 'at_operating_point', waiting)
    yield event
    event.set()


def test_frames_are_answered_while_a_threshold_is_calibrated_and_the_latest_wins(
        go, log, matched):
    before = matched.node._work.thresholds()
    assert matched.set('false_alarm_prob', 0.02).successful
    assert len(matched.see(frames=20)) == 20
    assert matched.set('false_alarm_prob', 0.3).successful
    assert len(matched.see(frames=20)) == 20
    assert matched.node._work.thresholds() == before
    go.set()
    matched.spin(lambda: matched.see() and matched.node._work.thresholds() != before)
    detector, operating = matched.node.live
    assert operating.false_alarm_prob == 0.3
    wanted = at_operating_point('sdt', detector, operating, SHAPE, log=lambda said: None)
    assert matched.node._work.thresholds()['threshold'] == wanted.threshold
    assert wanted.threshold < before['threshold']
    assert not [line for line in log if 'for 0.02 false alarms' in line]
    force, = [line for line in log if line.startswith('in force')]
    assert f'from frame {matched.stamp_s} on: matched, threshold' in force


def test_calibration_that_fails_is_said_and_set_back(started, log, monkeypatch):
    def failing(*arguments, check=None, **options):
        if check:
            raise ValueError('SDT.threshold = -inf, must be a number')
        return at_operating_point(*arguments, **options)

    monkeypatch.setattr(live_module, 'at_operating_point', failing)
    sdt = started(DetectorNode, 'sdt', rows=SHAPE[0], cols=SHAPE[1], false_alarm_prob=0.1)
    before = sdt.node._work.thresholds()
    assert sdt.set('false_alarm_prob', 0.999).successful
    sdt.spin(lambda: sdt.see() and sdt.get('false_alarm_prob') == [0.1])
    assert sdt.node._work.thresholds() == before
    assert ('not calibrated, so all stays as it is: SDT.threshold = -inf, must be a number'
            in log)
    assert sdt.node.live[1].false_alarm_prob == 0.1
    sdt.spin(lambda: sdt.changes() == [('false_alarm_prob', 0.999), ('false_alarm_prob', 0.1)])


def test_what_is_set_before_the_first_frame_holds_from_it_on(started):
    cdt = started(DetectorNode, 'cdt', operating_point='manual', threshold=20.0,
                  sensor__snr_db=20.0)
    assert cdt.set('threshold', 40.0).successful
    assert cdt.see(8.0) == [0]
