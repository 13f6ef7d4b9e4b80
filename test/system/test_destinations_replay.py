# SPDX-License-Identifier: Apache-2.0
"""Grid filters that know several destinations run in the graph, and replay to the same bytes."""

import csv

PLACES = {
    'probability': [0.45, 0.45], 'x_m': [15.0, 1.0], 'y_m': [14.0, 1.0], 'std_m': [1.0, 1.0],
    'earliest_frame': [14, 14], 'latest_frame': [16, 16]}
DETECTORS, FRAMES = ('hmm', 'pmf'), 15
SET = [word for name in DETECTORS for text in (
    f'{name}.operating_point=manual', f'{name}.threshold=1.0',
    *(f'{name}.destinations.{key}={value}' for key, value in PLACES.items()))
    for word in ('--set', text)] + ['--set', 'hmm.order=1', '--set', 'pmf.resolution=1']


def test_replay_with_destinations_gives_the_same_bytes(bringup, tmp_path):
    same = ('--detector', *DETECTORS, '--snr', '12', '--lockstep', *SET)
    runs = {
        'live': ('--scenario', 'example3', '--seed', '7', '--frames', str(FRAMES), '--record',
                 str(tmp_path / 'bag')),
        'again': ('--replay', str(tmp_path / 'bag'))}
    tables = []
    for name, arguments in runs.items():
        run = bringup(*same, *arguments, results=name)
        code, _, err = run.finish()
        assert code == 0, err
        tables.append([(run.results / table).read_bytes()
                       for table in ('frames.csv', 'detections.csv', 'tracks.csv')])
    assert tables[0] == tables[1]
    rows = list(csv.DictReader(tables[0][0].decode().splitlines()))
    for detector in DETECTORS:
        own = [row for row in rows if (row['detector'], row['level']) == (detector, 'detection')]
        assert len(own) == FRAMES
        assert sum(int(row['hits']) for row in own) > 5
