"""A run on a camera is planned as one on a bag, without a node that sends the frames."""

from pathlib import Path

from lowsnr_bringup.bags.recorded_run import RecordedRun
from lowsnr_bringup.bags.recording import CUSTOM_PARAMETERS
from lowsnr_bringup.plan.graph import to_yaml
from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_bringup.plan.run_plan import plan_run
from lowsnr_bringup.ros.frame_bag import FrameBag
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


def test_conditioner_alone_hears_the_camera():
    run = plan()
    assert [node.path for node in run.nodes] == [
        '/evaluator', '/tracker', '/sdt_detector', '/conditioner']
    assert remaps(run)['/conditioner'] == {f'image_raw:={TOPIC}'}
    assert remaps(run)['/sdt_detector'] == {'image_raw:=/conditioned/image_raw'}
    assert [path for path, own in run.parameters.items() if own.get('live')] == ['/conditioner']
    assert (run.name, run.frames, run.respawn) == ('camera_image_raw-sdt', None, True)


def test_without_a_conditioner_all_who_take_frames_hear_the_camera():
    run = plan('32FC1', detectors=['cdt', 'sdt'], condition='off', view=True)
    hear = f'image_raw:={TOPIC}'
    listeners = {'/evaluator', '/cdt/viewer', '/cdt/cdt_detector', '/sdt/viewer',
                 '/sdt/sdt_detector'}
    assert {path for path, own in remaps(run).items() if hear in own} == listeners
    assert {path for path, own in run.parameters.items() if own.get('live')} == listeners
    assert run.parameters['/cdt/cdt_detector']['rows'] == 31


def test_nobody_waits_for_a_sensor_and_nothing_is_true():
    evaluator = plan().parameters['/evaluator']
    assert (evaluator['consumers'], evaluator['truth']) == (1, False)
    assert evaluator['scenario'] == 'camera/image_raw'
    own = plan_run(RunOptions(detectors=['sdt'], scenario='example3'), CONFIG).parameters
    assert own['/evaluator']['consumers'] == 2


def test_size_noise_and_cadence_are_those_of_the_conditioned_camera():
    own = plan().parameters
    rows, cols = ConditioningSettings().size((31, 48))
    detector, tracker = own['/sdt_detector'], own['/tracker']
    assert (detector['rows'], detector['cols'], detector['sensor.noise_std']) == (rows, cols, 1.0)
    assert detector['sensor.frame_period_s'] == 0.04
    slow = plan(period_s=1.0).parameters['/tracker']
    assert tracker['motion.max_speed_mps'] == pytest.approx(25 * slow['motion.max_speed_mps'])


def test_recorder_is_there_before_the_camera_is_heard(tmp_path):
    run = plan(record=tmp_path / 'bag')
    assert run.nodes[0].path == '/recorder'
    assert run.parameters['/recorder']['topics'] == [TOPIC]
    assert run.parameters['/recorder']['live']
    assert run.parameters['/sdt_detector']['observers'] == 1


def test_what_is_said_still_holds():
    run = plan(snr_db=7.0, seed=4, respawn=False, camera='camera/image_raw')
    assert run.parameters['/sdt_detector']['sensor.snr_db'] == 7.0
    assert run.parameters['/tracker']['seed'] == 4
    assert not run.respawn


@pytest.mark.parametrize(('options', 'said'), [
    ({'frames': 5}, '--frames: not allowed with --camera: '),
    ({'loop': True}, '--loop: not allowed with --camera: '),
    ({'rate_hz': 5.0}, '--rate: not allowed with --camera: '),
    ({'lockstep': True}, '--lockstep: not allowed with --camera: '),
    ({'frames_topic': '/a'}, '--frames-topic: not allowed with --camera: '),
    ({'truth_topic': '/a'}, '--truth-topic: not allowed with --camera: '),
    ({'camera': 'no topic'}, "'no topic' is not the name of a topic, such as /camera/image_raw"),
    ({'camera': ''}, "'' is not the name of a topic"),
    ({'camera': '/a//b'}, "'/a//b' is not the name of a topic"),
])
def test_what_has_no_meaning_is_refused_before_the_camera_is_looked_at(options, said):
    def look(_):
        raise AssertionError('looked at')
    with pytest.raises(ValueError, match=said) as caught:
        plan_run(RunOptions(**{
            'detectors': ['sdt'], 'scenario': 'a', 'camera': TOPIC} | options), CONFIG, look)
    assert '\n' not in str(caught.value)


def test_frames_that_detectors_cannot_take_are_refused():
    with pytest.raises(ValueError, match=f'{TOPIC}: its frames are mono16, and detectors take '):
        plan(condition='off')


def test_a_topic_of_the_run_itself_is_no_camera():
    own = RecordedRun('a', 0, 9, 9, 1.0, truth=False, raw=True)
    options = {'detectors': ['sdt'], 'scenario': 'a', 'camera': '/conditioned/image_raw'}
    with pytest.raises(ValueError, match='--camera: a run publishes /conditioned/image_raw'):
        plan_run(RunOptions(**options), CONFIG, lambda _: own)
    assert plan_run(RunOptions(**options, condition='off'), CONFIG, lambda _: own).nodes


@pytest.mark.parametrize('condition', ['on', 'off'])
def test_replay_of_what_a_camera_showed_needs_nothing_said_again(tmp_path, condition):
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
