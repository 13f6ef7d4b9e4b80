# SPDX-License-Identifier: Apache-2.0
"""A run that is asked for a rate of false tracks states what it asked and what it scored."""

import csv

import pytest
from scipy.stats import poisson

RATE, FRAMES = 0.05, 300


def test_asked_and_measured_rates_are_in_summary_table_and_report(bringup):
    run = bringup(
        '--detector', 'cdt', '--scenario', 'empty', '--frames', str(FRAMES), '--lockstep',
        '--set', f'tracker.life.false_tracks={RATE}', '--set', 'all.false_alarm_prob=0.2',
        '--set', 'tracker.particles=300')
    code, out, err = run.finish()
    assert code == 0, err
    chain = run.summary()['detectors']['cdt']
    found = chain['track_metrics']['false_tracks']
    assert chain['false_tracks_asked'] == RATE
    with (run.results / 'tracks.csv').open() as table:
        ids = {row['id'] for row in csv.DictReader(table)}
    assert (found['tracks'], found['frames']) == (len(ids), FRAMES)
    assert found['per_frame'] == pytest.approx(found['tracks'] / found['frames'])
    # Within a factor of 1.5 for the error of the calibration, which has 100 false tracks or more.
    expected = RATE * FRAMES
    assert poisson.ppf(1e-3, expected / 1.5) <= found['tracks'] <= poisson.isf(
        1e-3, expected * 1.5)
    low, high = found['per_frame_interval']
    line = (f'cdt: false tracks a frame asked {RATE}, scored {found["per_frame"]:.4f} '
            f'[{low:.4f}, {high:.4f}]: {found["tracks"]} begin in {found["frames"]} frames')
    assert line in out
    assert line in (run.results / 'report.html').read_text()
    assert f'{RATE} false tracks a frame' in out + err  # the line of the calibration
