# SPDX-License-Identifier: Apache-2.0
"""What a replay takes from a bag: its frames with their truth, and the run they belong to."""

from pathlib import Path

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.recorded_run import inspect_bag
from lowsnr_bringup.bags.recording import CUSTOM_PARAMETERS
from lowsnr_bringup.bags.replay import played_frames
from lowsnr_bringup.bags.writer import BagWriter
from lowsnr_bringup.plan.config_files import to_yaml
from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_bringup.plan.run_plan import plan_run
from lowsnr_bringup.ros.frame_bag import FrameBag
from lowsnr_common.core.records import Truth
from lowsnr_common.ros import messages
import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray

CONFIG = Path(__file__).resolve().parents[2] / 'config'
MS = 1_000_000
TOPICS = ('/image_raw', '/ground_truth')


def camera_bag(folder, stamps_ms, truth=(), shape=(12, 18)):
    """Write a bag of frames that no run recorded."""
    with FrameBag(folder) as bag:
        for stamp_ms in stamps_ms:
            bag.add(np.zeros(shape), stamp_ms * MS, truth)
    return folder


def plan(bag, **options):
    return plan_run(
        RunOptions(**{'detectors': ['sdt'], 'scenario': '', 'replay': bag} | options), CONFIG)


def test_frames_and_period_of_an_unknown_bag_are_found(tmp_path):
    recorded = inspect_bag(camera_bag(tmp_path / 'beach', [0, 40, 80, 500, 541]), *TOPICS)
    assert (recorded.name, recorded.frames) == ('beach', 5)
    assert (recorded.rows, recorded.cols) == (12, 18)
    assert recorded.period_s == pytest.approx(0.0405)
    assert recorded.truth
    assert recorded.raw
    assert recorded.seed is None
    assert recorded.sensor == {}


def test_settings_of_an_unknown_bag_follow_its_period(tmp_path):
    bag = camera_bag(tmp_path / 'bag', [0, 40, 80], truth=None)
    values = plan(bag, snr_db=9.0, condition='off').parameters
    assert values['/sdt_detector']['sensor.frame_period_s'] == 0.04
    assert values['/sdt_detector']['sensor.snr_db'] == 9.0
    assert (values['/sdt_detector']['rows'], values['/sdt_detector']['cols']) == (12, 18)
    live = plan_run(RunOptions(detectors=['sdt'], scenario='example3'), CONFIG).parameters
    for name, power in (('max_speed_mps', -1), ('acceleration_density', -3),
                        ('mode_sojourn_s', 1)):
        assert values['/tracker'][f'motion.{name}'] == pytest.approx(
            live['/tracker'][f'motion.{name}'] * 0.04**power)
    assert values['/tracker']['life.lifetime_s'] == pytest.approx(
        live['/tracker']['life.lifetime_s'] * 0.04)
    assert values['/player']['truth_topic'] == ''
    assert values['/evaluator']['truth'] is False
    assert plan(bag, overrides=['tracker.motion.max_speed_mps=3.0']).parameters['/tracker'][
        'motion.max_speed_mps'] == 3.0


def test_raw_frames_pass_a_conditioner(tmp_path):
    run = plan(camera_bag(tmp_path / 'bag', [0, 40]), detectors=['cdt', 'sdt'],
               overrides=['conditioner.binning=2'])
    assert [node.path for node in run.nodes] == [
        '/evaluator', '/cdt/tracker', '/cdt/cdt_detector', '/sdt/tracker', '/sdt/sdt_detector',
        '/conditioner', '/player']
    assert run.nodes[0].remaps == ('camera_info:=/conditioned/camera_info',)
    info = 'camera_info:=/conditioned/camera_info'
    assert run.nodes[1].remaps == (info,)
    assert run.nodes[2].remaps == ('image_raw:=/conditioned/image_raw', info)
    values = run.parameters
    assert (values['/sdt/sdt_detector']['rows'], values['/sdt/sdt_detector']['cols']) == (6, 9)
    assert (values['/player']['rows'], values['/player']['cols']) == (12, 18)
    assert values['/player']['consumers'] == 2  # conditioner, evaluator
    assert values['/conditioner']['consumers'] == 2  # detectors


def recorded_bag(folder, options):
    """Write a bag as the recorder of a run with these options leaves it."""
    live = plan_run(RunOptions(**options), CONFIG)
    with FrameBag(folder, custom={CUSTOM_PARAMETERS: to_yaml(live.parameters)}) as bag:
        for k in (1, 2, 3):
            bag.add(np.zeros((20, 20)), 1000 * k * MS, ())
    return live


def test_recorded_run_needs_no_options(tmp_path):
    live = recorded_bag(tmp_path / 'bag', {
        'detectors': ['sdt'], 'scenario': 'example3', 'snr_db': 7.5, 'seed': 11,
        'overrides': ['sensor.sensor.noise_std=2.0']})
    run = plan(tmp_path / 'bag')
    assert run.name == 'example3-sdt'
    assert [node.path for node in run.nodes] == [
        '/evaluator', '/tracker', '/sdt_detector', '/player']
    for node in ('/tracker', '/evaluator', '/sdt_detector'):
        ours, theirs = (dict(values[node]) for values in (run.parameters, live.parameters))
        if node == '/evaluator':
            assert ours.pop('truth') is True
            assert (ours.pop('expected_frames'), theirs.pop('expected_frames')) == (3, 40)
        assert ours == theirs
    assert plan(tmp_path / 'bag', seed=3).parameters['/tracker']['seed'] == 3
    assert plan(tmp_path / 'bag', snr_db=3.0).parameters['/tracker']['sensor.snr_db'] == 3.0


def test_replay_of_a_recorded_replay_is_planned_alike(tmp_path):
    recorded_bag(tmp_path / 'sim', {'detectors': ['sdt'], 'scenario': 'example3'})
    for first in (camera_bag(tmp_path / 'cam', [0, 40, 80]), tmp_path / 'sim'):
        replay = plan(first)
        with FrameBag(tmp_path / f'{first.name}-2', custom={
                CUSTOM_PARAMETERS: to_yaml(replay.parameters)}) as bag, Bag(first) as source:
            for item in source.messages({'/image_raw'}):
                frame = messages.image_to_frame(deserialize_message(item.data, Image))
                bag.add(frame, item.logged_ns, ())
        again = plan(tmp_path / f'{first.name}-2')
        assert again.name == replay.name
        assert [node.path for node in again.nodes] == [node.path for node in replay.nodes]
        assert again.parameters['/player'].pop('bag') != replay.parameters['/player'].pop('bag')
        assert again.parameters == replay.parameters


def test_name_that_a_bag_tells_leads_nowhere(tmp_path):
    live = plan_run(RunOptions(detectors=['sdt'], scenario='example3'), CONFIG)
    live.parameters['/evaluator']['scenario'] = '../../etc/$(id) x'
    with FrameBag(tmp_path / 'bag', custom={CUSTOM_PARAMETERS: to_yaml(live.parameters)}) as bag:
        bag.add(np.zeros((20, 20)), MS, ())
    assert plan(tmp_path / 'bag').name == '.._.._etc_id_x-sdt'


@pytest.mark.parametrize('text', ['[', '3', 'a: b', '/evaluator: {ros__parameters: 3}'])
def test_unreadable_parameters_are_noted(tmp_path, text):
    with FrameBag(tmp_path / 'bag', custom={CUSTOM_PARAMETERS: text}) as bag:
        bag.add(np.zeros((3, 4)), MS, ())
    recorded = inspect_bag(tmp_path / 'bag', *TOPICS)
    assert recorded.raw
    assert len(recorded.notes) == 1
    assert recorded.notes[0].startswith(f'{tmp_path}/bag: ')


def test_frames_that_detectors_cannot_take_need_the_conditioner(tmp_path):
    with FrameBag(tmp_path / 'bag') as bag:
        bag.add(np.zeros((3, 4), np.uint8), MS, None)
    assert '/conditioner' in plan(tmp_path / 'bag').parameters
    with pytest.raises(ValueError, match='mono8.*--condition'):
        plan(tmp_path / 'bag', condition='off')


def test_bad_truth_is_named(tmp_path):
    with BagWriter(tmp_path / 'bag') as bag:
        bag.write(bag.add_topic('/image_raw', 'sensor_msgs/msg/Image'), image(1), 1, 1)
        truth = bag.add_topic('/ground_truth', 'vision_msgs/msg/Detection2DArray')
        bag.write(truth, b'\0\1\0\0\1', 1, 1)
    with pytest.raises(UnusableFile, match='/ground_truth') as caught:
        plan(tmp_path / 'bag')
    assert (caught.value.path, caught.value.reason) == (tmp_path / 'bag', 'bad message')


def test_a_bag_is_not_looped_and_a_simulation_not_conditioned(tmp_path):
    bag = camera_bag(tmp_path / 'bag', [0, 40])
    with pytest.raises(ValueError, match='--loop'):
        plan(bag, loop=True)
    with pytest.raises(ValueError, match='--condition on'):
        plan(None, scenario='example3', condition='on')
    with pytest.raises(UnusableFile) as caught:
        plan(None, scenario='example3', record=bag)
    assert (caught.value.path, caught.value.reason) == (bag, 'exists')


def test_recorder_is_there_before_the_frames_and_all_outputs_wait_for_it(tmp_path):
    run = plan(None, scenario='example3', record=tmp_path / 'bag', storage='sqlite3')
    assert [node.path for node in run.nodes] == [
        '/evaluator', '/tracker', '/sdt_detector', '/recorder', '/sensor']
    assert {values['observers'] for values in run.parameters.values()} == {1}
    assert run.parameters['/recorder']['storage'] == 'sqlite3'
    assert run.parameters['/recorder']['bag'] == str(tmp_path / 'bag')


def image(k):
    return serialize_message(messages.frame_to_image(np.full((2, 3), k), header(k)))


def header(k):
    return Header(stamp=messages.stamp_from_seconds(float(k)))


def test_truth_recorded_late_still_goes_before_its_frame(tmp_path):
    with BagWriter(tmp_path / 'bag') as bag:
        frames = bag.add_topic('/image_raw', 'sensor_msgs/msg/Image')
        truth = bag.add_topic('/ground_truth', 'vision_msgs/msg/Detection2DArray')
        for k in range(1, 41):
            bag.write(frames, image(k), k, k)
            if k > 3:
                array = Detection2DArray(header=header(k - 3))
                bag.write(truth, serialize_message(array), k, k)
    with Bag(tmp_path / 'bag') as bag:
        found = list(played_frames(bag, *TOPICS))
    assert [frame.stamp_ns // 10**9 for frame in found] == list(range(1, 41))
    assert [frame.truth is not None for frame in found] == [True] * 37 + [False] * 3
    assert all(deserialize_message(frame.image, Image).header.stamp.sec == k
               for k, frame in enumerate(found, start=1))


def test_odometry_goes_with_its_frame(tmp_path):
    state = np.array([3.0, 0.5, 2.0, -0.25])
    bag = camera_bag(tmp_path / 'bag', [40, 80], [Truth('a', state), Truth('b', state)])
    with Bag(bag) as opened:
        assert [len(frame.odometry) for frame in played_frames(opened, *TOPICS)] == [2, 2]
    with Bag(bag) as opened:
        found = list(played_frames(opened, '/image_raw', ''))
    assert [(len(frame.odometry), frame.truth) for frame in found] == [(0, None)] * 2


@pytest.mark.parametrize('info_first', [False, True])
@pytest.mark.parametrize(('topic', 'beside'), [
    ('/camera/image_raw', '/camera/camera_info'), ('/image_raw', '/camera_info'),
    ('/camera/image_raw/compressed', '/camera/camera_info')])
def test_camera_info_goes_with_its_frame(tmp_path, info_first, topic, beside):
    with BagWriter(tmp_path / 'bag') as bag:
        frames = bag.add_topic(topic, 'sensor_msgs/msg/Image')
        infos = bag.add_topic(beside, 'sensor_msgs/msg/CameraInfo')
        for k in range(1, 41):
            info = serialize_message(CameraInfo(header=header(k), width=k))
            both = [(frames, image(k))] + [(infos, info)] * (k != 2)
            for place, data in both[::-1] if info_first else both:
                bag.write(place, data, k, k)
    with Bag(tmp_path / 'bag') as opened:
        found = [(frame.stamp_ns // 10**9, frame.camera_info)
                 for frame in played_frames(opened, topic, '')]
    assert [number for number, _ in found] == list(range(1, 41))
    assert [info and deserialize_message(info, CameraInfo).width for _, info in found] == [
        1, b'', *range(3, 41)]
