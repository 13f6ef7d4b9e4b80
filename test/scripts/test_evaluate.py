# SPDX-License-Identifier: Apache-2.0
"""Recorded runs and interrupted ones are scored without a node, with the figures of a live run."""

import json
import os
from pathlib import Path
import subprocess
import sys

from builtin_interfaces.msg import Time
from graph_runs import own_domain
from graph_runs import start_bringup
from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.recording import CUSTOM_PARAMETERS
from lowsnr_bringup.bags.type_definitions import type_definition
from lowsnr_bringup.bags.writer import BagWriter
from lowsnr_common.core.records import Estimate
from lowsnr_common.ros import messages
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import CompressionFormat
from rosbags.rosbag2 import CompressionMode
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer
from std_msgs.msg import Header
import yaml

ROOT = Path(__file__).resolve().parents[2]
ARRAY = 'vision_msgs/msg/Detection2DArray'
FRAMES = 20
EXPORTED = ('detections.csv', 'tracks.csv')


def evaluate(*arguments):
    """Run the command to its end."""
    return subprocess.run(
        [sys.executable, str(ROOT / 'scripts' / 'evaluate.py'), *map(str, arguments)],
        capture_output=True, text=True, timeout=120.0, check=False, env=dict(os.environ))


@pytest.fixture(scope='module')
def recorded(tmp_path_factory):
    """Return the bag of a run of two detectors, and the run's results."""
    folder = tmp_path_factory.mktemp('recorded')
    with start_bringup(
            folder / 'live', '--detector', 'cdt', 'sdt', '--lockstep', '--scenario',
            'three_objects', '--snr', '15', '--frames', str(FRAMES), '--record',
            str(folder / 'bag'), '--set', 'cdt.operating_point=nominal',
            '--set', 'sdt.operating_point=nominal', '--set', 'evaluator.gate_cells=2.0',
            domain_id=own_domain()) as run:
        code, _, err = run.finish()
    assert code == 0, err
    return folder / 'bag', run.results


def test_scores_are_those_of_the_live_run(recorded, tmp_path):
    bag, live = recorded
    done = evaluate(bag, '--results', tmp_path / 'run', '--smooth')
    assert (done.returncode, done.stderr) == (0, '')
    assert (tmp_path / 'run' / 'frames.csv').read_bytes() == (live / 'frames.csv').read_bytes()
    ours, theirs = (
        json.loads((run / 'summary.json').read_text()) for run in (tmp_path / 'run', live))
    for figures in (*ours['detectors'].values(), *theirs['detectors'].values()):
        for key in ('latency_ms', 'detection_latency_ms'):
            assert figures.pop(key)['median'] > 0.0
    assert ours == theirs
    assert (tmp_path / 'run' / 'smoothed.csv').read_text().count('\n') > FRAMES
    assert ours['evaluation']['gate_cells'] == 2.0
    assert ours['detectors']['sdt']['detection']['hits'] > 0
    assert f'{FRAMES} frames published, {FRAMES} scored' in done.stdout
    page = (tmp_path / 'run' / 'report.html').read_text()
    assert '<canvas' in page or '<img' in page or '<svg' in page
    assert 'scripts/evaluate.py' in page


def test_declarations_are_exported_as_the_live_run_wrote_them(recorded, tmp_path):
    bag, live = recorded
    done = evaluate(bag, '--export', tmp_path / 'out')
    assert (done.returncode, done.stderr) == (0, '')
    found = {path.name: path.read_text() for path in (tmp_path / 'out').iterdir()}
    assert found == {name: (live / name).read_text() for name in EXPORTED}
    assert found[EXPORTED[0]].count('\n') > FRAMES
    assert EXPORTED[0] in evaluate(bag, '--export', tmp_path / 'out').stderr


def copied(source, folder, topics, mode=CompressionMode.NONE, plugin=StoragePlugin.SQLITE3):
    """Write some topics of a bag, and one more, as another program does."""
    writer = Writer(folder, version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with Bag(source) as bag, writer:
        channels = {}
        for name, msgtype in [('/chatter', 'std_msgs/msg/Header'), *(
                (name, bag.topics[name]) for name in topics)]:
            definition = type_definition(msgtype)
            channels[name] = writer.add_connection(
                name, msgtype, msgdef=definition.text, rihs01=definition.digest)
        for item in bag.messages(topics):
            writer.write(channels['/chatter'], item.logged_ns, serialize_message(Header()))
            writer.write(channels[item.topic], item.logged_ns, item.data)
    return folder


@pytest.mark.parametrize(('mode', 'plugin'), [
    (CompressionMode.NONE, StoragePlugin.SQLITE3), (CompressionMode.FILE, StoragePlugin.SQLITE3),
    (CompressionMode.MESSAGE, StoragePlugin.MCAP), (CompressionMode.STORAGE, StoragePlugin.MCAP)])
def test_bag_that_another_program_recorded_is_scored(recorded, tmp_path, mode, plugin):
    bag, live = recorded
    topics = [f'/{name}{level}' for name in ('ground_truth', 'sdt/detections', 'sdt/tracks')
              for level in ('', '/odometry')]
    done = evaluate(copied(bag, tmp_path / 'other', topics, mode, plugin),
                    '--results', tmp_path / 'run')
    assert (done.returncode, done.stderr) == (0, '')
    summary = json.loads((tmp_path / 'run' / 'summary.json').read_text())
    assert (summary['scenario'], list(summary['detectors'])) == ('other', ['sdt'])
    theirs = json.loads((live / 'summary.json').read_text())['detectors']['sdt']['tracking']
    ours = summary['detectors']['sdt']['tracking']
    # The bag does not hold the gate of two cells: only GOSPA is the same.
    assert ours['gospa_m'] == theirs['gospa_m']
    assert ours['declared'] == theirs['declared'] > 0


def test_without_truth_declarations_are_counted(recorded, tmp_path):
    bag, live = recorded
    done = evaluate(copied(bag, tmp_path / 'other', ['/sdt/detections', '/sdt/tracks']),
                    '--results', tmp_path / 'run')
    assert (done.returncode, done.stderr) == (0, '')
    summary = json.loads((tmp_path / 'run' / 'summary.json').read_text())
    assert summary['frames'] == {
        'expected': None, 'published': FRAMES, 'scored': FRAMES, 'unanswered': 0, 'unseen': 0,
        'lost': 0}
    levels = summary['detectors']['sdt']
    theirs = json.loads((live / 'summary.json').read_text())['detectors']['sdt']
    for level in ('detection', 'tracking'):
        assert levels[level]['declared'] == theirs[level]['declared']
        assert levels[level]['frames_without_truth'] == FRAMES
        for key in ('pd', 'pd_interval', 'pfa_per_frame', 'hits', 'false_alarms', 'gospa_m',
                    'rmse_position_m', 'first_detection_latency_frames', 'frames_with_object'):
            assert levels[level][key] is None, key
    assert f'{FRAMES} frames without truth' in done.stdout


def detection_bag(folder, arrays):
    """Write detections, tracks and truth without odometry; the object moves a cell a frame."""
    with BagWriter(folder) as bag:
        topics = {name: bag.add_topic(name, ARRAY) for name in arrays}
        for k in range(1, 6):
            header = Header(stamp=messages.stamp_from_seconds(float(k)))
            state = np.array([3.0 + k, np.nan, 4.0, np.nan])
            for name, (identity, shift) in arrays.items():
                item = Estimate(state + shift, np.eye(4), 1.0, identity)
                array = messages.estimates_to_array([item], header, 1.0)
                bag.write(topics[name], serialize_message(array), k, k)
    return folder


def test_arrays_without_odometry_are_scored_by_position(tmp_path):
    bag = detection_bag(tmp_path / 'bag', {
        '/detections': ('', 0.5), '/tracks': ('1', 3.0), '/marked': ('a', 0.0)})
    done = evaluate(bag, '--truth-topic', '/marked', '--results', tmp_path / 'run')
    assert (done.returncode, done.stderr) == (0, '')
    levels = json.loads((tmp_path / 'run' / 'summary.json').read_text())['detectors']['recorded']
    assert (levels['detection']['hits'], levels['detection']['false_alarms']) == (5, 0)
    assert levels['detection']['rmse_position_m'] == pytest.approx(0.5 * 2**0.5)
    assert levels['detection']['rmse_velocity_mps'] is None
    assert (levels['tracking']['hits'], levels['tracking']['false_alarms']) == (0, 5)


@pytest.mark.parametrize(('topics', 'arguments', 'names'), [
    ({'/tracks': ('1', 0.0)}, [], ['truth', 'detections']),
    ({'/marked': ('1', 0.0)}, [], ['detections', 'tracks', ARRAY]),
    ({'/detections': ('', 0.0), '/marked': ('a', 0.0)}, ['--truth-topic', '/true'],
     ['/true', ARRAY, '--truth-topic', '/detections', '/marked']),
])
def test_bag_that_cannot_be_scored_ends_with_one_line(tmp_path, topics, arguments, names):
    bag = detection_bag(tmp_path / 'bag', topics)
    check_rejected(evaluate(bag, *arguments, '--results', tmp_path / 'run'), tmp_path, *names)


@pytest.mark.parametrize('data', [b'', b'words', b'\x89MCAP0\r\n'])
def test_file_that_is_no_bag_ends_with_one_line(tmp_path, data):
    (tmp_path / 'bag.mcap').write_bytes(data)
    check_rejected(evaluate(tmp_path / 'bag.mcap', '--results', tmp_path / 'run'), tmp_path)


def check_rejected(done, folder, *names):
    """Check status, the one line that names the bag and more, and that nothing was written."""
    assert (done.returncode, done.stdout) == (2, '')
    assert done.stderr.startswith(f'evaluate.py: {folder}/bag')
    assert len(done.stderr.splitlines()) == 1
    assert all(name in done.stderr for name in names)
    assert not (folder / 'run').exists()


def test_run_whose_bringup_was_killed_gets_its_summary_and_report(tmp_path):
    with start_bringup(tmp_path / 'run', '--detector', 'cdt', '--loop', '--lockstep',
                       domain_id=own_domain()) as run:
        run.wait_for_rows(40)
        run.process.kill()
        run.wait_until_none_is_left()
    assert not (run.results / 'summary.json').exists()
    done = evaluate(run.results)
    assert (done.returncode, done.stderr) == (0, '')
    frames = run.summary()['frames']
    assert frames['scored'] >= 20
    assert frames['unanswered'] <= 1  # the one that the evaluator had in hand
    assert frames['published'] == frames['scored'] + frames['unanswered'] == len(run.rows()) // 2
    assert f'{frames["scored"]} scored' in done.stdout
    assert (run.results / 'report.html').is_file()
    # Options that say where results go and what to read are for bags.
    again = evaluate(run.results, '--results', tmp_path / 'other')
    assert (again.returncode, again.stdout) == (2, '')
    assert str(run.results) in again.stderr
    assert not (tmp_path / 'other').exists()


def test_damaged_bag_is_scored_up_to_the_damage(recorded, tmp_path):
    data = (recorded[0] / 'bag.mcap').read_bytes()
    (tmp_path / 'bag.mcap').write_bytes(data[:-100])
    done = evaluate(tmp_path / 'bag.mcap', '--results', tmp_path / 'run')
    assert done.returncode == 0
    assert f'{tmp_path}/bag.mcap' in done.stderr
    assert f'{FRAMES} scored' in done.stdout


def test_help_shows_an_example():
    done = evaluate('--help')
    assert done.returncode == 0
    assert 'example: python scripts/evaluate.py' in done.stdout


MARKUP = '</script><script>x()</script><img src=x onerror=x()>'


def test_markup_in_a_bag_stays_inert_in_the_report(tmp_path):
    told = yaml.safe_dump({'/evaluator': {'ros__parameters': {
        'scenario': MARKUP, 'detectors': [MARKUP], 'operating_points': [MARKUP]}}})
    with BagWriter(tmp_path / 'bag', custom={CUSTOM_PARAMETERS: f'# {MARKUP}\n{told}'}) as bag:
        topic = bag.add_topic(f'/{MARKUP}/detections', ARRAY)
        for k in range(1, 4):
            estimate = Estimate(np.array([k, 0.0, 2.0, 0.0]), np.eye(4), 0.9, MARKUP)
            array = messages.estimates_to_array(
                [estimate], Header(stamp=Time(sec=k), frame_id=MARKUP), 1.0)
            bag.write(topic, serialize_message(array), k, k)
    done = evaluate(tmp_path / 'bag', '--results', tmp_path / 'run')
    assert done.returncode == 0, done.stderr
    page = (tmp_path / 'run' / 'report.html').read_text()
    assert 'onerror' in page
    assert '<img src=x' not in page
    assert page.count('<script') == page.count('</script')
    assert '<script>x()' not in page
