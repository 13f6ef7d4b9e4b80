# SPDX-License-Identifier: Apache-2.0
"""
Real sequences from file to bag to graph: tracks lie on the object, in pixels of the raw frames.

The sequences lie in shared/data beside the checkout, and are no part of it: a checkout without
them skips these tests, save under ``CI=true``, where they must be there.
"""

import os
from pathlib import Path
import subprocess
import sys

from graph_runs import graph_environment
from graph_runs import own_domain
from graph_runs import start_bringup
from lowsnr_bringup.bags.reader import Bag
from lowsnr_common.ros import messages
from lowsnr_eval.scene.scene_files import read_scene
from lowsnr_eval.scoring.camera_table import read_views
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / 'shared' / 'data'
TOPICS = ('/image_raw', '/camera_motion', '/tracks')
GATE_PX = 5.0


def sequence(name):
    """Return the arrays of a sequence, or end the test without them."""
    path = DATA / f'{name}.npz'
    if not path.is_file():
        end = pytest.fail if os.environ.get('CI') == 'true' else pytest.skip
        end(f'needs the sequence {path}, which is not there')
    with np.load(path) as archive:
        return dict(archive)


@pytest.fixture
def replayed(tmp_path):
    """Return a function that runs a sequence; it returns its arrays, answers and summary."""
    def run(name, detector):
        data = sequence(name)
        subprocess.run(
            [sys.executable, str(ROOT / 'scripts' / 'convert.py'), str(DATA / f'{name}.npz'),
             '--out', str(tmp_path / 'frames')], check=True, timeout=120, capture_output=True)
        with start_bringup(
                tmp_path / 'run', '--replay', str(tmp_path / 'frames'), '--detector', detector,
                '--snr', '8', '--lockstep', '--record', str(tmp_path / 'recorded'),
                domain_id=own_domain()) as replay:
            code, _, err = replay.finish(within_s=400.0)
        assert code == 0, err
        frames, answers = replay.summary()['frames'], recorded(tmp_path / 'recorded')
        assert frames['unanswered'] == 0
        assert {topic: len(found) for topic, found in answers.items()} == dict.fromkeys(
            TOPICS, frames['published'])
        # Whatever the conditioner does inside, answers are about the frame of their header.
        assert {message.header.frame_id for topic in ('/tracks', '/camera_motion')
                for message in answers[topic]} == {answers['/image_raw'][0].header.frame_id}
        check_results(tmp_path / 'run', data, answers)
        assert replay.summary()['detectors'][detector]['pfa_asked'] == 0.01
        return data, answers, replay.summary()
    return run


def check_results(results, data, answers):
    """Check the frames for the report, and the motion of the camera for smoothed paths."""
    lines, frames, cells, _ = read_scene(results)
    assert len(lines) == len(data['frames'])
    for line, frame, plane in zip(lines, frames, cells):
        assert frame.shape == data['frames'][0].shape
        assert plane.shape == (frame.shape[0] // 2, frame.shape[1] // 2)
        assert line['cells']['side'] == 2
    motion = [message.transform.translation for message in answers['/camera_motion']]
    np.testing.assert_allclose(
        [*read_views(results).values()], [(2, each.x, each.y) for each in motion],
        rtol=1e-7, atol=1e-7)


def recorded(bag):
    """Return the messages of the topics in the order of their stamps."""
    answers = {topic: [] for topic in TOPICS}
    with Bag(bag) as source:
        for message in source.messages(set(TOPICS)):
            answers[message.topic].append(source.read(message))
    for found in answers.values():
        found.sort(key=lambda message: messages.stamp_key(message.header.stamp))
    return answers


def tracks_of(answers):
    """Return the places x, y of the confirmed tracks of every frame, in pixels."""
    return [np.reshape([
        (item.bbox.center.position.x, item.bbox.center.position.y)
        for item in array.detections], (-1, 2)) for array in answers['/tracks']]


def near(places, objects):
    """Return which places are near which objects, (places, objects)."""
    return np.linalg.norm(places[:, None] - objects, axis=-1) <= GATE_PX


def followed(tracks, truth):
    """Return the share of frames, from the tenth after it appeared, with a track on the object."""
    present = np.isfinite(truth).all(axis=-1)
    asked = np.flatnonzero(present & (np.arange(len(truth)) >= np.argmax(present) + 10))
    assert len(asked) > 20
    return np.mean([near(tracks[k], truth[None, k]).any() for k in asked])


def test_bird_is_followed_in_raw_pixels_while_the_camera_turns(replayed):
    data, answers, summary = replayed('dd_bird_026_pan', 'auto')
    assert np.ptp(data['camera_offset'], axis=0).max() > 60  # more than the cells may lag behind
    assert followed(tracks_of(answers), data['truth']) >= 0.9
    motion = np.array([(message.transform.translation.x, message.transform.translation.y)
                       for message in answers['/camera_motion']])
    error = motion + data['camera_offset'] - (motion + data['camera_offset'])[5]
    assert np.median(np.linalg.norm(error, axis=1)) < 0.2
    evaluation = summary['evaluation']
    assert (evaluation['gate_cells'], evaluation['pixels']) == (3.0, True)


@pytest.mark.slow
def test_bird_is_followed_in_raw_pixels_by_a_still_camera(replayed):
    data, answers, _ = replayed('dd_bird_026', 'auto')
    assert followed(tracks_of(answers), data['truth']) >= 0.9
    assert {(message.transform.translation.x, message.transform.translation.y)
            for message in answers['/camera_motion']} == {(0.0, 0.0)}


@pytest.mark.slow
def test_star_in_a_coronagraph_is_followed_without_false_tracks(replayed):
    data, answers, _ = replayed('lasco_c3_8dB', 'mmtbd2')
    tracks = tracks_of(answers)
    assert followed(tracks, data['truth']) >= 0.8
    known = np.concatenate(
        [data['truth'][None], data['other_truth'], data['uncatalogued_truth']])
    false = [not near(places, known[:, k]).any(axis=1).all() for k, places in enumerate(tracks)]
    assert np.mean(false) < 0.02


@pytest.mark.slow
def test_benchmark_finds_the_same_in_this_process_and_through_the_graph(tmp_path):
    """The object of a still camera, as recorded and erased; the last column is a time."""
    sequence('dd_drone_151')
    rows = []
    for option in ((), ('--graph',)):
        out = subprocess.run(
            [sys.executable, str(ROOT / 'benchmarks' / 'real_frames.py'), '--sequence',
             'dd_drone_151', '--out', str(tmp_path), *option], check=True, timeout=400,
            capture_output=True, text=True, env=graph_environment(own_domain())).stdout
        rows += [line.split('|')[1:-2] for line in out.splitlines() if 'dd_drone_151' in line]
    assert rows[0] == rows[1]
    assert float(rows[0][2].split('/')[0]) > 0.9
