# SPDX-License-Identifier: Apache-2.0
"""The scene of a run on disk: frames, conditioned cells and marks, whatever comes first."""

from contextlib import closing

from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.records import Estimate
from lowsnr_eval.scene import scene_writer
from lowsnr_eval.scene.scene_files import read_scene
from lowsnr_eval.scene.scene_files import reduced
from lowsnr_eval.scene.scene_files import reduction
from lowsnr_eval.scene.scene_writer import SceneWriter
from lowsnr_eval.scoring.frame_scoring import Answer
import numpy as np
import pytest

SHAPE = (7, 5)


def tracked(x, y, name=''):
    return Estimate(np.array([x, 0.5, y, 0.0]), np.eye(4), 0.9, name)


def test_cells_are_read_back_with_their_place_in_the_frame(tmp_path):
    """A cell of 2 x 2 pixels whose image moved by (-3, 5) pixels; the second has no cells."""
    where = FrameMap('camera', (5, 7), 2, (4, -1), (-3.0, 5.0))
    with closing(SceneWriter(tmp_path, 1.0, conditioned=True)) as scene:
        for k in (1, 2, 3):
            scene.add_answers(k, k, [], {})
            scene.add_frame(k, np.full(SHAPE, float(k)))
            if k != 2:
                scene.add_cells(k, np.full((3, 2), k / 2), where)
    for resumed in (False, True):
        if resumed:
            SceneWriter(tmp_path, 1.0, resumed, conditioned=True).close()
        lines, frames, cells, _ = read_scene(tmp_path)
        assert [frame[0, 0] for frame in frames] == [1.0, 2.0, 3.0]
        assert [None if c is None else c.tolist() for c in cells] == [
            [[0.5, 0.5]] * 3, None, [[1.5, 1.5]] * 3]
        # Its first pixel is 2 x 4 - 3 = 5 right and -2 + 5 = 3 down; the edge half a pixel before.
        assert lines[0]['cells'] == {'shape': [3, 2], 'corner': [4.5, 2.5], 'side': 2}
        assert lines[1]['cells'] is None


def test_statistic_is_read_back_with_the_place_of_the_cells_it_is_of(tmp_path):
    """Of two chains, frames of 5 x 7 pixels in cells of 2 x 2; the second frame has no cells."""
    where = FrameMap('camera', (5, 7), 2, (4, -1), (-3.0, 5.0))
    answers = {'sdt': Answer([], []), 'cdt': Answer([], [])}
    for conditioned in (True, False):
        folder = tmp_path / str(conditioned)
        folder.mkdir()
        with closing(SceneWriter(
                folder, 1.0, conditioned=conditioned, statistics=['cdt'])) as scene:
            for k in (1, 2):
                scene.add_answers(k, k, [], answers)
                scene.add_frame(k, np.full(SHAPE, float(k)))
                scene.add_statistic('cdt', k, np.full((3, 2), -k / 4))
                if k == 1 and conditioned:
                    scene.add_cells(k, np.zeros((3, 2)), where)
        lines, frames, _, statistics = read_scene(folder)
        assert [frame[0, 0] for frame in frames] == [1.0, 2.0]
        found = [[] if not own else own['cdt'].tolist() for own in statistics]
        assert found == [[[-0.25, -0.25]] * 3, [] if conditioned else [[-0.5, -0.5]] * 3]
        assert lines[0]['chains']['cdt']['statistic'] == (
            {'shape': [3, 2], 'corner': [4.5, 2.5], 'side': 2} if conditioned
            else {'shape': [3, 2], 'corner': [-0.5, -0.5], 'side': 1})
        assert 'statistic' not in lines[0]['chains']['sdt']


def test_frame_waits_for_a_statistic_that_arrives_last(tmp_path):
    with closing(SceneWriter(tmp_path, 1.0, statistics=['cdt'])) as scene:
        for k in (1, 2, 3):
            scene.add_frame(k, np.zeros(SHAPE))
            scene.add_answers(k, k, [], {'cdt': Answer([], [])})
        for k in (1, 3):  # the detector rejected the second frame
            scene.add_statistic('cdt', k, np.full(SHAPE, float(k)))
        assert len(read_scene(tmp_path).lines) == 3
    assert [own.get('cdt', np.zeros((1, 1)))[0, 0]
            for own in read_scene(tmp_path).statistics] == [1.0, 0.0, 3.0]


def test_marks_are_in_cells_and_those_without_a_place_are_left_out(tmp_path):
    with closing(SceneWriter(tmp_path, 0.5)) as scene:
        scene.add_frame(1, np.zeros(SHAPE))
        scene.add_answers(
            1, 1, [], {'sdt': Answer([tracked(1.0, 2.0), tracked(np.nan, 2.0)], None)})
    lines, *_ = read_scene(tmp_path)
    assert lines[0]['chains']['sdt'] == {'detections': [[2.0, 4.0, '']], 'tracks': None}


def test_frame_and_its_marks_arrive_in_any_order(tmp_path):
    with closing(SceneWriter(tmp_path, 1.0)) as scene:
        scene.add_answers(1, 10, [], {})
        scene.add_frame(10, np.full(SHAPE, 1.0))
        scene.add_frame(20, np.full(SHAPE, 2.0))
        scene.add_answers(2, 20, [], {})
        scene.add_answers(3, 30, [], {})  # its frame does not come
        scene.add_frame(35, np.full(SHAPE, 3.5))  # it has no marks
        scene.add_frame(40, np.full(SHAPE, 4.0))
        scene.add_answers(4, 40, [], {})
        scene.add_answers(5, 50, [], {})  # nor does this one's, to the end
    lines, frames, *_ = read_scene(tmp_path)
    assert [line['frame'] for line in lines] == [1, 2, 3, 4, 5]
    assert [None if f is None else f[0, 0] for f in frames] == [1.0, 2.0, None, 4.0, None]


def test_frames_that_wait_for_their_marks_are_bounded(tmp_path):
    with closing(SceneWriter(tmp_path, 1.0)) as scene:
        for k in range(1000):
            scene.add_frame(k, np.zeros(SHAPE))
        for k in range(1000):
            scene.add_answers(k, k, [], {})
    lines, frames, *_ = read_scene(tmp_path)
    assert len(lines) == 1000
    assert sum(frame is not None for frame in frames) == scene_writer.WAITING


def test_large_frame_is_reduced_to_its_brightest_cells(rng):
    assert reduction((256, 320)) == 1
    assert reduction((1024, 1024)) == 3
    assert (reduction((16384, 16384)) ** 2) * 2**17 >= 16384**2
    frame = rng.standard_normal((7, 11))
    expected = [[frame[r:r + 3, c:c + 3].max() for c in range(0, 11, 3)] for r in range(0, 7, 3)]
    assert np.array_equal(reduced(frame, 3), np.float32(expected))
    frame[0, :2], frame[3:6, 3:6] = np.nan, np.nan  # a few without a value, and a whole block
    expected = [[np.nanmax(frame[r:r + 3, c:c + 3]) if (r, c) != (3, 3) else np.nan
                 for c in range(0, 11, 3)] for r in range(0, 7, 3)]
    np.testing.assert_array_equal(reduced(frame, 3), np.float32(expected))


@pytest.mark.parametrize('frame', [np.zeros((30, 40)), None])
def test_scene_on_disk_is_bounded(tmp_path, monkeypatch, frame):
    monkeypatch.setattr(scene_writer, 'BUDGET', 10_000)
    with closing(SceneWriter(tmp_path, 1.0)) as scene:
        for k in range(1, 1001):
            if frame is not None:
                scene.add_frame(k, frame)
            scene.add_answers(k, k, [], {'sdt': Answer([tracked(1.0, 2.0)], [])})
    assert scene.full
    lines, *_ = read_scene(tmp_path)
    assert 1 < len(lines) < 1000
    assert (tmp_path / 'frames.f32').stat().st_size <= 40_000
    assert (tmp_path / 'scene.jsonl').stat().st_size <= 10_000


def test_full_disk_ends_the_scene_and_nothing_else(tmp_path):
    (tmp_path / 'frames.f32').symlink_to('/dev/full')
    with closing(SceneWriter(tmp_path, 1.0)) as scene:
        scene.add_frame(1, np.zeros(SHAPE))
        scene.add_answers(1, 1, [], {})
        assert scene.full
        scene.add_answers(2, 2, [], {})
    assert (tmp_path / 'scene.jsonl').read_text() == ''


@pytest.mark.parametrize('conditioned', [False, True])
@pytest.mark.parametrize('last', [0, 20])
def test_statistic_that_stops_takes_no_picture_of_frames_and_other_chains(
        tmp_path, last, conditioned):
    count, cells = 3 * scene_writer.WAITING, FrameMap('camera', SHAPE[::-1], 1, (0, 0), (0.0, 0.0))
    with closing(SceneWriter(
            tmp_path, 1.0, conditioned=conditioned, statistics=['sdt', 'cdt'])) as scene:
        for k in range(1, count + 1):
            scene.add_frame(k, np.full(SHAPE, float(k)))
            if conditioned:
                scene.add_cells(k, np.full(SHAPE, -k), cells)
            for name in ['sdt', 'cdt'] if k <= last else ['sdt']:
                scene.add_statistic(name, k, np.full(SHAPE, k / 2))
            scene.add_answers(k, k, [], {name: Answer([], []) for name in ('sdt', 'cdt')})
    _, frames, planes, statistics = read_scene(tmp_path)
    assert [frame[0, 0] for frame in frames] == list(range(1, count + 1))
    assert [plane[0, 0] for plane in planes if plane is not None] == [
        -k for k in range(1, count + 1) if conditioned]
    assert [each['sdt'][0, 0] for each in statistics] == [k / 2 for k in range(1, count + 1)]
    assert [k for k, each in enumerate(statistics, 1) if 'cdt' in each] == [*range(1, last + 1)]
