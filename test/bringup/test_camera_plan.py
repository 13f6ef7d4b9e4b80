# SPDX-License-Identifier: Apache-2.0
"""The plan of a run on a camera: no node of the run publishes the frames."""

from functools import partial
from pathlib import Path

import calibrate
from lowsnr_bringup.bags.recording import CUSTOM_PARAMETERS
from lowsnr_bringup.plan.config_files import to_yaml
from lowsnr_bringup.plan.recorded_frames import RecordedRun
from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_bringup.plan.run_plan import plan_run
from lowsnr_bringup.ros.frame_bag import FrameBag
from lowsnr_detect.calibration import operating_point
from lowsnr_detect.calibration.simulated_curve import simulate_curve
from lowsnr_sensor.conditioning.conditioner import ConditioningSettings
import numpy as np
import pytest

CONFIG = Path(__file__).resolve().parents[2] / 'config'
TOPIC = '/camera/image_raw'


def plan(encoding='mono16', period_s=0.04, **options):
    """Plan a run on a camera of 48 x 31 pixels."""
    def look(topic):
        return RecordedRun(
            name=topic.strip('/'), frames=0, rows=31, cols=48, period_s=period_s, truth=False,
            raw=True, encoding=encoding)
    return plan_run(RunOptions(**{
        'detectors': ['sdt'], 'scenario': 'example3', 'camera': TOPIC} | options), CONFIG, look)


def remaps(run):
    return {node.path: set(node.remaps) for node in run.nodes if node.remaps}


def test_detectors_of_a_camera_read_the_frames_of_the_conditioner():
    run = plan()
    assert [node.path for node in run.nodes] == [
        '/evaluator', '/tracker', '/sdt_detector', '/conditioner']
    readers = ['/evaluator', '/conditioner']
    info = 'camera_info:=/conditioned/camera_info'
    assert [remaps(run)[path] - {info} for path in readers] == 2 * [{f'image_raw:={TOPIC}'}]
    assert info in remaps(run)['/evaluator']
    assert remaps(run)['/sdt_detector'] == {'image_raw:=/conditioned/image_raw', info}
    assert remaps(run)['/tracker'] == {info}
    assert [path for path, own in run.parameters.items() if own.get('live')] == readers
    assert run.parameters['/tracker']['conditioned']
    shape = [(run.parameters[path]['rows'], run.parameters[path]['cols'])
             for path in ('/conditioner', '/sdt_detector')]
    assert shape == [(31, 48), (15, 24)]  # pixels, cells
    assert (run.name, run.frames, run.respawn) == ('camera_image_raw-sdt', None, True)


def test_without_a_conditioner_every_reader_of_frames_subscribes_to_the_camera():
    run = plan('32FC1', detectors=['cdt', 'sdt'], condition='off', view=True)
    camera = f'image_raw:={TOPIC}'
    readers = {'/evaluator', '/cdt/viewer', '/cdt/cdt_detector', '/sdt/viewer',
               '/sdt/sdt_detector'}
    assert {path for path, own in remaps(run).items() if camera in own} == readers
    assert {path for path, own in run.parameters.items() if own.get('live')} == readers
    assert run.parameters['/cdt/cdt_detector']['rows'] == 31


def test_camera_waits_for_no_simulation_unless_the_user_asks_for_it(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    run = plan(detectors=['auto', 'hmm'])
    assert run.parameters['/auto/auto_detector']['operating_point'] == 'adaptive'
    assert run.parameters['/hmm/hmm_detector']['operating_point'] == 'nominal'
    assert run.parameters['/evaluator']['operating_points'] == ['adaptive', 'nominal']
    note, = run.notes
    command = 'calibrate.py --detector hmm --snr 6 --rows 15 --cols 24 '
    assert note.startswith('hmm ')
    assert command in note
    assert '--detector auto' in note
    forced = plan(detectors=['hmm'], overrides=['hmm.operating_point=matched'])
    assert forced.parameters['/hmm_detector']['operating_point'] == 'matched'
    assert not forced.notes


def test_calibration_that_is_at_hand_is_used_at_any_frame_period(tmp_path, monkeypatch):
    """The command that the note names makes it; a second start leaves nothing new."""
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    monkeypatch.setattr(
        operating_point, 'simulate_curve', partial(simulate_curve, frames=3, runs=4))
    options = calibrate.parse_arguments(
        ['--detector', 'hmm', '--snr', '6', '--rows', '15', '--cols', '24'])
    for case in calibrate.planned(options, *options.snr, *options.false_alarm_prob):
        calibrate.calibrate_detector(*case, print)
    made = sorted(tmp_path.rglob('*.json'))
    assert len(made) == 1
    for period_s in (0.04, 0.0333, 0.03334, 1.0, 60.0):
        run = plan(detectors=['hmm'], period_s=period_s)
        assert run.parameters['/hmm_detector']['operating_point'] == 'matched'
        assert not run.notes
        at = operating_point.curve(run.detectors['/hmm_detector'], (15, 24))
        assert at.runs == 4
    assert sorted(tmp_path.rglob('*.json')) == made


def test_thresholds_of_a_camera_adapt_unless_the_user_says_otherwise():
    forced = plan(overrides=['sdt.operating_point=nominal'])
    assert forced.parameters['/sdt_detector']['operating_point'] == 'nominal'
    simulated = plan_run(RunOptions(detectors=['sdt'], scenario='example3'), CONFIG)
    assert simulated.parameters['/sdt_detector']['operating_point'] == 'matched'


@pytest.mark.parametrize('binning', [1, 2])
def test_gate_of_conditioned_frames_is_that_of_their_cells_in_pixels(binning):
    run = plan(overrides=[f'conditioner.binning={binning}'])
    simulated = plan_run(RunOptions(detectors=['sdt'], scenario='example3'), CONFIG)
    for name, cells in (('gate_cells', 1.5), ('gospa_cutoff_cells', 5.0)):
        assert run.parameters['/evaluator'][name] == binning * cells
        assert simulated.parameters['/evaluator'][name] == cells
    forced = plan(overrides=['evaluator.gate_cells=4.0'])
    assert forced.parameters['/evaluator']['gate_cells'] == 4.0


def test_no_node_waits_for_a_sensor_or_for_truth():
    evaluator = plan().parameters['/evaluator']
    assert (evaluator['consumers'], evaluator['truth']) == (0, False)
    assert evaluator['scenario'] == 'camera/image_raw'
    own = plan_run(RunOptions(detectors=['sdt'], scenario='example3'), CONFIG).parameters
    assert own['/evaluator']['consumers'] == 1


def test_size_noise_and_cadence_are_those_of_the_conditioned_camera():
    own = plan().parameters
    rows, cols = ConditioningSettings().size((31, 48))
    detector, tracker = own['/sdt_detector'], own['/tracker']
    assert (detector['rows'], detector['cols'], detector['sensor.noise_std']) == (rows, cols, 1.0)
    assert detector['sensor.frame_period_s'] == 0.04
    slow = plan(period_s=1.0).parameters['/tracker']
    assert tracker['motion.max_speed_mps'] == pytest.approx(25 * slow['motion.max_speed_mps'])


def test_recorder_starts_first(tmp_path):
    run = plan(record=tmp_path / 'bag')
    assert run.nodes[0].path == '/recorder'
    assert run.parameters['/recorder']['topics'] == [TOPIC]
    assert run.parameters['/recorder']['live']
    assert run.parameters['/sdt_detector']['observers'] == 1


def test_options_hold_as_in_any_run():
    run = plan(snr_db=7.0, seed=4, respawn=False, camera='camera/image_raw')
    assert run.parameters['/sdt_detector']['sensor.snr_db'] == 7.0
    assert run.parameters['/tracker']['seed'] == 4
    assert not run.respawn


@pytest.mark.parametrize(('options', 'culprit'), [
    ({'frames': 5}, '--frames'),
    ({'loop': True}, '--loop'),
    ({'rate_hz': 5.0}, '--rate'),
    ({'lockstep': True}, '--lockstep'),
    ({'frames_topic': '/a'}, '--frames-topic'),
    ({'truth_topic': '/a'}, '--truth-topic'),
    ({'camera': 'no topic'}, "--camera: 'no topic'"),
    ({'camera': ''}, "--camera: ''"),
    ({'camera': '/a//b'}, "--camera: '/a//b'"),
])
def test_option_without_meaning_for_a_camera_is_refused_by_name(options, culprit):
    with pytest.raises(ValueError) as caught:
        RunOptions(**{'detectors': ['sdt'], 'scenario': 'a', 'camera': TOPIC} | options)
    assert str(caught.value).startswith(culprit)
    assert '\n' not in str(caught.value)


def test_encoding_that_detectors_cannot_read_is_refused_without_a_conditioner():
    with pytest.raises(ValueError, match='mono16') as caught:
        plan(condition='off')
    assert str(caught.value).startswith(f'{TOPIC}: ')


@pytest.mark.parametrize(('seen', 'condition', 'part'), [
    ({'blank': 'frame 3'}, 'off', 'frame 3'), ({'rows': 1}, 'on', '9 x 1'),
    ({'cols': 1}, 'auto', '1 x 9')])
def test_frames_that_every_node_would_reject_are_refused(seen, condition, part):
    values = {'name': 'a', 'frames': 0, 'rows': 9, 'cols': 9, 'period_s': 1.0, 'truth': False}
    found = RecordedRun(**values | {'raw': True} | seen)
    options = RunOptions(detectors=['sdt'], scenario='a', camera=TOPIC, condition=condition)
    with pytest.raises(ValueError, match=part) as caught:
        plan_run(options, CONFIG, lambda _: found)
    assert str(caught.value).startswith(f'{TOPIC}: ')


def test_topic_of_the_run_itself_is_no_camera():
    own = RecordedRun('a', 0, 9, 9, 1.0, truth=False, raw=True)
    options = {'detectors': ['sdt'], 'scenario': 'a', 'camera': '/conditioned/image_raw'}
    with pytest.raises(ValueError, match='/conditioned/image_raw') as caught:
        plan_run(RunOptions(**options), CONFIG, lambda _: own)
    assert str(caught.value).startswith('--camera: ')
    assert plan_run(RunOptions(**options, condition='off'), CONFIG, lambda _: own).nodes


@pytest.mark.parametrize('condition', ['on', 'off'])
def test_recorded_camera_is_replayed_without_further_options(tmp_path, condition):
    live = plan('32FC1', camera='/cam/image', record=tmp_path / 'bag', condition=condition)
    text = to_yaml(live.parameters)
    with FrameBag(
            tmp_path / 'bag', custom={CUSTOM_PARAMETERS: text}, frames_topic='/cam/image') as bag:
        for k in range(4):
            bag.add(np.zeros((31, 48)), (k + 1) * 40_000_000, None)
    again = plan(camera=None, replay=tmp_path / 'bag')
    assert again.parameters['/player']['frames_topic'] == '/cam/image'
    assert again.name == 'cam_image-sdt'
    assert ('/conditioner' in again.parameters) == (condition == 'on')
    for node in ('/tracker', '/sdt_detector'):
        theirs = {key: value for key, value in live.parameters[node].items()
                  if key not in ('observers', 'live')}
        assert {key: again.parameters[node][key] for key in theirs} == theirs
