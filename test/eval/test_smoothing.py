# SPDX-License-Identifier: Apache-2.0
"""Smoothed paths from the tables of a run, against weighted least squares over whole paths."""

from collections import Counter
from contextlib import closing

from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.writer import BagWriter
from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.motion import process_noise_cov
from lowsnr_common.core.motion import transition_matrix
from lowsnr_common.core.records import Estimate
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.scoring.camera_table import View
from lowsnr_eval.scoring.recorded_chains import find_chains
from lowsnr_eval.scoring.run_scoring import RunScorer
from lowsnr_eval.smoothing.error_table import format_errors
from lowsnr_eval.smoothing.path_smoothing import smooth_path
from lowsnr_eval.smoothing.recorded_paths import Point
from lowsnr_eval.smoothing.recorded_paths import read_paths
from lowsnr_track.pda_mmpf import PdaMmpf
import numpy as np
import pytest
from smoothed_run import DENSITY
from smoothed_run import FRAMES
from smoothed_run import NOISE_CELLS
from smoothed_run import Run
from smoothed_run import SECOND

NAN = np.nan


def least_squares(run, frames):
    """Return states (K, 4) [x, v_x, y, v_y] and covariances of the best path, in pixels."""
    side, count = run.binning, len(frames)
    density = DENSITY * side**2
    information, vector = np.zeros((4 * count, 4 * count)), np.zeros(4 * count)

    def add(matrix, cov, value):
        nonlocal information, vector
        weight = np.linalg.inv(cov)
        information = information + matrix.T @ weight @ matrix
        vector = vector + matrix.T @ weight @ value

    def block(k, part):
        matrix = np.zeros((part.shape[0], 4 * count))
        matrix[:, 4 * k:4 * k + 4] = part
        return matrix

    in_scene = [run.tracked[k] - run.camera[k] for k in frames]
    first = np.array([in_scene[0][0], 1.5, in_scene[0][1], 0.75])
    add(block(0, np.eye(4)), np.diag([(0.3 * side)**2, 0.01] * 2), first)
    for n, k in enumerate(frames[1:], start=1):
        dt = float(k - frames[n - 1])
        add(block(n, np.eye(4)) - block(n - 1, transition_matrix(dt)),
            process_noise_cov(dt, density), np.zeros(4))
        add(block(n, np.eye(4)[[0, 2]]), (NOISE_CELLS * side)**2 * np.eye(2),
            run.detected[k] - run.camera[k])
    cov = np.linalg.inv(information)
    states = (cov @ vector).reshape(-1, 4)
    states[:, [0, 2]] += run.camera[frames]
    return states, [cov[4 * n:4 * n + 4, 4 * n:4 * n + 4] for n in range(count)]


@pytest.mark.parametrize(('binning', 'moving'), [(1, False), (2, True)])
@pytest.mark.parametrize('skipped', [(), (3, 4, 5, 9)])
def test_path_is_the_least_squares_path(tmp_path, binning, moving, skipped):
    run = Run(tmp_path, binning, moving)
    rows, errors = run.write(skipped)
    frames = [k for k in range(FRAMES) if k not in skipped]
    assert rows['stamp_s'].tolist() == [k + 1.0 for k in frames]
    states, covs = least_squares(run, frames)
    for n, name in enumerate(('x', 'v_x', 'y', 'v_y')):
        np.testing.assert_allclose(rows[name], states[:, n], atol=1e-6)
        np.testing.assert_allclose(rows[f'cov_{name}_{name}'], [c[n, n] for c in covs], rtol=1e-6)
    np.testing.assert_allclose(rows['cov_x_v_x'], [cov[0, 1] for cov in covs], rtol=1e-6)
    np.testing.assert_allclose(rows['cov_y_v_x'], 0.0, atol=1e-9)
    true = (run.truth + run.camera)[frames]
    near = np.hypot(*(run.tracked[frames] - true).T) <= 1.5  # pixels
    for path, places in (('filtered', run.tracked[frames]), ('smoothed', states[:, [0, 2]])):
        assert errors[f'{path}_rmse_position'] == pytest.approx(
            np.sqrt(np.mean(np.sum((places - true)[near] ** 2, axis=1))), rel=1e-6)
    assert (errors['tracks'], errors['points']) == (1, near.sum())
    assert errors['filtered_rmse_velocity'] == pytest.approx(0.0, abs=1e-9)


def test_track_of_one_frame_keeps_its_state(tmp_path):
    run = Run(tmp_path)
    rows, errors = run.write(only=(4,))
    np.testing.assert_allclose([rows['x'][0], rows['y'][0]], run.tracked[4])
    assert (rows['cov_x_x'][0], rows['cov_v_x_v_x'][0]) == pytest.approx((0.09, 0.01))
    assert errors['smoothed_rmse_position'] == pytest.approx(errors['filtered_rmse_position'])


def test_run_without_tracks_has_an_empty_table(tmp_path):
    run = Run(tmp_path)
    rows, errors = run.write(only=())
    assert len(rows['x']) == 0
    assert errors['nees_position'] is None
    assert format_errors({'sdt': errors}, run.evaluation).splitlines()[3].split() == [
        'sdt', '0', '0', *'-----']


@pytest.mark.parametrize('deviation', [1e8, 1e12])
def test_deviation_beyond_all_bounds_is_one_that_knows_nothing(deviation):
    """So the path is that of the measurements alone, as with any other large deviation."""
    rng = np.random.default_rng(2)
    places = 10.0 + 0.3 * rng.standard_normal((30, 2))
    motion, found = PdaMmpf().motion, []
    for sd in (1e3, deviation):
        points = [
            Point(k, k * SECOND, View(), (*place, 0.0, 0.0, 0.3, 0.3, sd, sd), (*place, 0.3, 0.3),
                  (NAN,) * 4) for k, place in enumerate(places)]
        found.append(smooth_path(points, motion, 1.0))
    np.testing.assert_allclose(found[0].states[1:], found[1].states[1:], atol=0.05)
    assert np.linalg.eigvalsh(found[1].covs).min() > 0.0


def test_detection_belongs_to_the_track_nearest_to_it(tmp_path):
    """The track beside it is not detected, and a false alarm is in its own gate alone."""
    settings = RunSettings(results=str(tmp_path), scenario='s', truth=False)
    with closing(RunScorer(settings, Evaluation(), lambda *_: None)) as scorer:
        for topic, items in (
                ('detections', [estimate(0.1), estimate(-1.4)]),
                ('tracks', [estimate(0.0, 'a'), estimate(1.4, 'b')])):
            for item in items:
                scorer.add_state(topic, SECOND, item)
            scorer.add_array(topic, SECOND, items, 0.0)
        scorer.score()
    paths = {path.name: path.points[0].detected[0]
             for path in read_paths(tmp_path, None, 1.5, Counter())}
    assert paths == {'a': 0.1, 'b': pytest.approx(NAN, nan_ok=True)}


def estimate(x, name=''):
    return Estimate(np.array([x, 0.0, 0.0, 0.0]), np.eye(4), 0.9, name)


def test_velocity_that_was_not_recorded_is_found(tmp_path):
    rows, errors = Run(tmp_path).write(velocity=(NAN, NAN))
    assert errors['filtered_rmse_velocity'] is None
    np.testing.assert_allclose(rows['v_x'][4:], 1.5, atol=0.2)


def test_frame_without_a_map_is_left_out_and_counted(tmp_path):
    run = Run(tmp_path, 2, True)
    rows, errors = run.write(maps={0, 1, 2, 4, 5, 6, 7, 8, 9, 10, 11})
    assert errors['left_out'] == 1
    assert format_errors({'sdt': errors}, run.evaluation).splitlines()[-1].startswith('sdt: 1 ')
    assert rows['frame'].astype(int).tolist() == [k for k in range(1, 13) if k != 4]


def test_moving_camera_without_maps_is_named(tmp_path):
    run = Run(tmp_path, 2, True)
    run.write()
    path = tmp_path / 'camera.csv'
    path.write_text(path.read_text().splitlines(keepends=True)[0])
    with pytest.raises(ValueError, match=r'camera\.csv'):
        run.smoothed()
    path.unlink()
    with pytest.raises(ValueError, match=r'camera\.csv'):
        run.smoothed()


def test_tracks_are_told_apart_by_their_ids(tmp_path):
    rows, errors = Run(tmp_path).write(names=['1'] * 6 + ['b c'] * 6)
    assert rows['id'] == ['1'] * 6 + ['b%20c'] * 6
    assert errors['tracks'] == 2


@pytest.mark.parametrize('text', ['1.000000000,2,0', 'x,2,0,0', '1.000000000,0,0,0',
                                  '1.000000000,2,nan,0'])
def test_damaged_table_of_the_camera_is_named(tmp_path, text):
    run = Run(tmp_path, 2, True)
    run.write()
    path = tmp_path / 'camera.csv'
    path.write_text(f'{path.read_text()}{text}\n')
    with pytest.raises(ValueError) as caught:
        run.smoothed()
    assert str(caught.value).startswith(f'{path}: ')
    assert not (tmp_path / 'smoothed.csv.tmp').exists()


def test_chain_that_the_run_does_not_have_is_named(tmp_path):
    run = Run(tmp_path)
    run.write()
    path = tmp_path / 'tracks.csv'
    path.write_text(f'{path.read_text()}12,12.000000000,cdt,4,1,1,0,0,1,1,1,1,0.9\n')
    with pytest.raises(ValueError) as caught:
        run.smoothed()
    assert str(caught.value).startswith(f'{path}: ')
    assert not (tmp_path / 'smoothed.csv.tmp').exists()
    assert (tmp_path / 'smoothed.csv').exists()  # the earlier one


def test_restarted_evaluator_continues_the_table_of_the_camera(tmp_path):
    run = Run(tmp_path, 2, True)
    run.write()
    path = tmp_path / 'camera.csv'
    whole = path.read_text()
    path.write_text(whole[:-5])
    with closing(RunScorer(run.settings, Evaluation(), lambda *_: None, resumed=True,
                           conditioned=True)) as scorer:
        scorer.add_map(FRAMES * SECOND, FrameMap(
            'camera', (90, 90), 2, (0, 0), tuple(run.camera[-1])))
    assert path.read_text() == whole


@pytest.mark.parametrize(('names', 'kept'), [
    (['camera_info'], ['camera_info']), (['image_raw'], []),
    (['image_raw', 'camera_info'], ['camera_info', 'image_raw'])])
def test_bag_needs_maps_alone_for_the_table_of_the_camera(tmp_path, names, kept):
    kinds = {'camera_info': 'sensor_msgs/msg/CameraInfo', 'image_raw': 'sensor_msgs/msg/Image'}
    with BagWriter(tmp_path / 'bag') as bag:
        bag.add_topic('/detections', 'vision_msgs/msg/Detection2DArray')
        for name in names:
            bag.add_topic(f'/conditioned/{name}', kinds[name])
    with Bag(tmp_path / 'bag') as bag:
        found = find_chains(bag, {}).cells_topics
    assert found == tuple(f'/conditioned/{name}' for name in kept)
