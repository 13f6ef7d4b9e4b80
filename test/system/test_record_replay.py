# SPDX-License-Identifier: Apache-2.0
"""A run is recorded over DDS without loss; its replay and evaluation give the same scores."""

import contextlib
import errno
import functools
import json
import os
import resource
import shutil
import signal
import time

from graph_runs import own_domain
from graph_runs import start_bringup
from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.recorded_run import inspect_bag
from lowsnr_bringup.bags.recording import RecordingSummary
from lowsnr_bringup.bags.recording import summarize_recording
from lowsnr_bringup.ros.frame_bag import FrameBag
from lowsnr_common.ros.messages import stamp_key
from mcap_ros2.reader import read_ros2_messages
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosReliability

FRAMES = 15
STORAGES = ['mcap', pytest.param('sqlite3', marks=pytest.mark.slow)]
MANUAL = ('--set', 'sdt.operating_point=manual', '--set', 'sdt.threshold=4.0')
RUN = ('--detector', 'sdt', '--lockstep', *MANUAL)
DATA = ('/image_raw', '/ground_truth', '/detections', '/tracks', '/tracks/tentative', '/clock',
        '/statistic')


def frames_csv(run):
    """Return ``frames.csv`` of a run that ended well."""
    code, out, err = run.finish()
    assert code == 0, err
    return (run.results / 'frames.csv').read_bytes(), out


@pytest.fixture(scope='module')
def recorded(tmp_path_factory):
    """Return a function that records a run in a storage format; it returns bag and scores."""
    @functools.cache
    def record(storage):
        folder = tmp_path_factory.mktemp(storage)
        with start_bringup(
                folder / 'live', *RUN, '--scenario', 'example3', '--snr', '12', '--seed', '7',
                '--frames', str(FRAMES), '--record', str(folder / 'bag'), '--storage', storage,
                '--statistic', domain_id=own_domain()) as run:
            return folder / 'bag', frames_csv(run)[0]
    return record


@pytest.mark.parametrize('storage', STORAGES)
def test_replay_of_a_recorded_run_gives_the_same_bytes(bringup, recorded, storage):
    bag, live = recorded(storage)
    summary = summarize_recording(bag)
    assert (summary.finished, summary.losses) == (True, {})
    assert live.count(b'\n') == 1 + 2 * FRAMES
    assert len({line.split(b',')[5] for line in live.splitlines()}) > 2  # something was declared
    with Bag(bag) as opened:
        found = {name: [opened.read(item) for item in opened.messages({name})] for name in DATA}
    for name in DATA:
        assert len(found[name]) == FRAMES, name
    stamps = [stamp_key(message.header.stamp) for message in found['/tracks']]
    assert stamps == [k * 10**9 for k in range(1, FRAMES + 1)]
    again, _ = frames_csv(bringup(*RUN, '--replay', str(bag), results='again'))
    assert again == live


def test_bag_tells_types_and_quality_of_service(recorded):
    bag, _ = recorded('mcap')
    with AnyReader([bag]) as reader:  # computes each hash and rejects one that differs
        qos = {item.topic: item.ext.offered_qos_profiles for item in reader.connections}
        for item, _, data in reader.messages():
            reader.deserialize(data, item.msgtype)
    for name in DATA:
        assert [item.reliability for item in qos[name]] == [QosReliability.RELIABLE], name
    found = list(read_ros2_messages(bag / 'bag.mcap'))
    assert {item.channel.topic for item in found} >= {*DATA, '/scored', '/diagnostics'}
    for item in found:
        assert 0 <= item.log_time_ns - item.publish_time_ns < 60 * 10**9
        assert abs(item.log_time_ns / 1e9 - bag.stat().st_mtime) < 300.0
    origin = inspect_bag(bag, '/image_raw', '/ground_truth')
    assert (origin.name, origin.seed, origin.raw) == ('example3', 7, False)


def test_other_detectors_run_on_the_frames_that_were_recorded(bringup, recorded):
    bag, _ = recorded('mcap')
    run = bringup(
        '--detector', 'cdt', 'cusum', '--replay', str(bag), '--frames', '5', '--rate', '100',
        '--set', 'cdt.operating_point=nominal', '--set', 'cusum.operating_point=nominal',
        results='both')
    both, _ = frames_csv(run)
    assert both.count(b'\n') == 1 + 2 * 2 * 5
    assert run.summary()['frames'] == {
        'expected': 5, 'published': 5, 'scored': 5, 'unanswered': 0, 'unseen': 0, 'lost': 0}


def camera_bag(folder, frames=12):
    """Write a bag without truth, of another topic, 25 frames a second."""
    rng = np.random.default_rng(3)
    with FrameBag(folder, frames_topic='/cam/image') as bag:
        for k in range(frames):
            bag.add(rng.normal(size=(9, 13)), 1_700_000_000_000_000_000 + k * 40_000_000, None)
    return folder


def test_bag_without_truth_is_replayed_at_its_own_pace_and_counted(bringup, tmp_path):
    run = bringup(
        '--detector', 'cdt', '--replay', str(camera_bag(tmp_path / 'beach')), '--frames-topic',
        '/cam/image', '--condition', 'off', '--set', 'cdt.operating_point=manual', '--set',
        'cdt.threshold=2.0')
    table, _ = frames_csv(run)
    summary = run.summary()
    assert summary['scenario'] == 'beach'
    assert summary['frames'] == {
        'expected': 12, 'published': 12, 'scored': 12, 'unanswered': 0, 'unseen': 0, 'lost': 0}
    detection = summary['detectors']['cdt']['detection']
    assert detection['declared'] > 0
    assert detection['frames_without_truth'] == 12
    assert {detection[key] for key in (
        'pd', 'pfa_per_frame', 'gospa_m', 'hits', 'false_alarms')} == {None}
    assert table.splitlines()[1].startswith(b'1,1700000000.0,cdt,detection,,')


def wait_for_bytes(path, count):
    """Wait until a file holds this much."""
    until = time.monotonic() + 120.0
    while not (path.is_file() and path.stat().st_size > count):
        assert time.monotonic() < until, path
        time.sleep(0.02)


def wait_for_frames(bag, count):
    """Wait until a bag that is being written holds so many frames on the disk."""
    until, found = time.monotonic() + 120.0, 0
    while found < count:
        assert time.monotonic() < until, found
        time.sleep(0.1)
        with contextlib.suppress(ValueError):  # read while it is written
            found = inspect_bag(bag, '/image_raw', '/ground_truth').frames


@pytest.mark.parametrize('storage', STORAGES)
def test_bag_is_readable_after_the_recorder_was_killed(bringup, tmp_path, storage):
    bag = tmp_path / 'bag'
    run = bringup('--detector', 'cdt', '--loop', '--no-respawn', '--rate', '25',
                  '--record', str(bag), '--storage', storage)
    run.wait_for_rows(2 * 100)
    scored = len(run.rows()) // 2
    wait_for_frames(bag, scored)
    os.kill(run.nodes()['recorder_node'], signal.SIGKILL)
    code, _, err = run.finish()
    assert code == 1
    assert 'recorder' in err
    assert 'SIGKILL' in err
    assert summarize_recording(bag) == RecordingSummary(bag)
    recorded = inspect_bag(bag, '/image_raw', '/ground_truth')
    assert recorded.frames >= scored
    assert (recorded.name, recorded.raw) == ('example4', False)
    assert all(note.startswith(str(bag)) for note in recorded.notes)


def test_full_disk_ends_the_recording(bringup, tmp_path):
    bag = tmp_path / 'bag'
    run = bringup('--detector', 'cdt', '--loop', '--no-respawn', '--rate', '100',
                  '--record', str(bag))
    run.wait_for_rows(2 * 20)
    most = 500_000
    resource.prlimit(run.nodes()['recorder_node'], resource.RLIMIT_FSIZE, (most, most))
    code, _, err = run.finish()
    assert code == 1
    assert f'{bag}: ' in err
    assert os.strerror(errno.EFBIG) in err
    assert 'Traceback' not in err
    assert inspect_bag(bag, '/image_raw', '/ground_truth').frames > 20


def test_existing_folder_is_never_written_to(bringup, tmp_path):
    (tmp_path / 'bag').mkdir()
    run = bringup('--record', str(tmp_path / 'bag'))
    code, out, err = run.finish()
    assert (code, out) == (2, '')
    assert err.startswith(f'bringup.py: {tmp_path}/bag: ')
    assert err.count('\n') == 1
    assert not run.results.exists()
    assert list((tmp_path / 'bag').iterdir()) == []


def test_empty_bag_file_ends_with_one_line(bringup, tmp_path):
    (tmp_path / 'bag.mcap').write_bytes(b'')
    run = bringup('--replay', str(tmp_path / 'bag.mcap'))
    code, out, err = run.finish()
    assert (code, out) == (2, '')
    assert err.startswith(f'bringup.py: {tmp_path}/bag.mcap: ')
    assert err.count('\n') == 1
    assert not run.results.exists()


def test_damaged_bag_is_replayed_up_to_the_damage(bringup, recorded, tmp_path):
    bag = shutil.copytree(recorded('mcap')[0], tmp_path / 'bag')
    file = bag / 'bag.mcap'
    # Cut within the summary at the end of the file: all frames are there.
    file.write_bytes(file.read_bytes()[:-100])
    run = bringup(*RUN, '--replay', str(bag), results='again')
    code, _, err = run.finish()
    assert code == 0
    assert f'{file}: ' in err
    assert json.loads((run.results / 'summary.json').read_text())['frames']['scored'] == FRAMES
