# SPDX-License-Identifier: Apache-2.0
"""An array given to the library has the detections and tracks that a graph has of its frames."""

import csv

import lowsnr
import numpy as np
import pytest

SEED, SNR_DB = 5, 9.0
# Thresholds that need no simulation; that of SDT is calibrated, and read from the same cache.
BY_HAND = {
    'bernoulli.operating_point': 'manual', 'bernoulli.threshold': 1.0,
    'hmm.operating_point': 'manual', 'hmm.threshold': 1.0, 'hmm.order': 0, 'hmm.lag': 3}
COLUMNS = ('x', 'y', 'v_x', 'v_y', 'sd_x', 'sd_y', 'sd_v_x', 'sd_v_y', 'score')
PERIOD_S = 0.1


def of(name):
    """Return the settings of a detector."""
    return {key: value for key, value in BY_HAND.items() if key.startswith(f'{name}.')}


def rows_of(run, table):
    """Return the rows that a graph wrote: detector, index of the frame, id, values."""
    with (run.results / table).open() as file:
        return [(row['detector'], int(row['frame']) - 1, row['id'],
                 [float(row[name] or 'nan') for name in COLUMNS])
                for row in csv.DictReader(file)]


def check(run, results):
    """Check that every row of a graph is that of the library, to the digits of the files."""
    for table in ('detections', 'tracks'):
        rows = rows_of(run, f'{table}.csv')
        for name, result in results.items():
            own = [row for row in rows if row[0] == name]
            found = getattr(result, table)
            assert len(own) > 5
            assert [row[1] for row in own] == found['frame'].tolist()
            if table == 'tracks':
                assert [int(row[2]) for row in own] == found['id'].tolist()
            np.testing.assert_allclose(
                [row[3] for row in own], np.stack([found[name] for name in COLUMNS], axis=1),
                rtol=1e-8, atol=1e-12)
        assert len(rows) == sum(len(getattr(result, table)) for result in results.values())


def test_simulated_frames(bringup):
    run = bringup(
        '--detector', 'sdt', 'bernoulli', 'hmm', '--scenario', 'crossing', '--snr', str(SNR_DB),
        '--seed', str(SEED), '--lockstep',
        *(word for name, value in BY_HAND.items() for word in ('--set', f'{name}={value}')))
    code, _, err = run.finish()
    assert code == 0, err
    frames = lowsnr.simulate('crossing', snr_db=SNR_DB, seed=SEED).frames
    check(run, {
        'sdt': lowsnr.track(frames, 'sdt', SNR_DB, seed=SEED),
        **{name: lowsnr.track(frames, name, SNR_DB, seed=SEED, settings=of(name))
           for name in ('bernoulli', 'hmm')}})


@pytest.fixture
def camera_frames(rng):
    """Return 16-bit frames of a camera that turns over a scene in which an object moves."""
    scene = np.kron(rng.uniform(500.0, 900.0, (24, 40)), np.ones((4, 4)))
    rows, cols = np.indices((64, 80))
    frames = []
    for k in range(50):
        left = k // 2
        spot = np.exp(-((cols + left - 20.0 - 1.6 * k)**2 + (rows - 30.0 - 0.3 * k)**2) / 1.3)
        frames.append(scene[8:72, left:left + 80] + 90.0 * spot + rng.normal(0.0, 12.0, (64, 80)))
    return np.rint(frames).astype(np.uint16)


def test_frames_of_a_camera(bringup, tmp_path, camera_frames):
    path = tmp_path / 'frames.npz'
    np.savez(path, frames=camera_frames)
    run = bringup('--replay', str(path), '--detector', 'auto', '--lockstep', '--snr', '8',
                  '--period', str(PERIOD_S), '--seed', str(SEED))
    code, _, err = run.finish()
    assert code == 0, err
    before = camera_frames.copy()
    result = lowsnr.track(camera_frames, snr_db=8, period_s=PERIOD_S, seed=SEED)
    check(run, {'auto': result})
    assert (camera_frames == before).all()
    assert (result.detector, result.conditioned) == ('auto', True)
    assert result.settings['auto.operating_point'] == 'adaptive'
    assert run.summary()['detectors']['auto']['pfa_asked'] == result.alarm_rate.asked
