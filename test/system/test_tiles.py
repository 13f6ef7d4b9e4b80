# SPDX-License-Identifier: Apache-2.0
"""A detector that is divided into tiles gives the tables of one, also where a tile dies."""

import re

from graph_runs import run_bringup
import pytest
from run_checks import check_none_lost
from run_checks import PATIENT

LOCKSTEP = ('--scenario', 'example3', '--frames', '60', '--lockstep')
TABLES = ('frames.csv', 'detections.csv', 'tracks.csv', 'truth.csv')


def tables(run):
    """Return the bytes of all tables of a run."""
    return {name: (run.results / name).read_bytes() for name in TABLES}


def test_tiles_in_two_parts_give_the_bytes_of_the_whole_run(bringup, tmp_path):
    options = (*LOCKSTEP, '--detector', 'cdt', 'sdt', '--tiles', '2x2')
    apart = ('sdt.sdt_2', 'sdt.sdt_3', 'cdt.cdt_4')
    most = bringup(
        *options, '--expect', *apart, '--record', str(tmp_path / 'bag'), results='most')
    names = [f'{name}.{each}' for name in ('cdt', 'sdt') for each in (
        'tracker', f'{name}_detector', *(f'{name}_{number}' for number in range(1, 5)))]
    rest = ['evaluator', 'recorder', 'sensor', *(name for name in names if name not in apart)]
    some = bringup(
        *options, '--only', *apart, '--record', str(tmp_path / 'other'), '--expect', *rest,
        results='some')
    for run in (most, some):
        code, _, err = run.finish()
        assert code == 0, err
    whole = bringup(*LOCKSTEP, '--detector', 'cdt', 'sdt', results='whole')
    assert whole.finish()[0] == 0
    assert tables(most) == tables(whole)
    assert most.summary()['frames'] == whole.summary()['frames']
    assert [found['pfa_asked'] for found in most.summary()['detectors'].values()] == [0.01, 0.01]
    replayed = bringup('--replay', str(tmp_path / 'bag'), '--lockstep', '--detector', 'sdt',
                       '--tiles', '1x3', '--set', 'sdt.operating_point=matched', results='again')
    assert replayed.finish()[0] == 0
    assert replayed.summary()['frames']['scored'] == 60


def test_killed_tile_comes_back_and_the_frame_it_had_is_answered_without(bringup):
    run = bringup('--scenario', 'example3', '--frames', '300', '--lockstep', '--respawn',
                  '--tiles', '2x1', *PATIENT)
    run.wait_for_rows(40)
    run.kill('tile_node')
    code, _, err = run.finish()
    assert code == 0, err
    frames, summary = check_none_lost(run), run.summary()
    assert frames['scored'] == 300
    assert [*summary['restarts'].values()] == [1]
    assert {*summary['restarts']} <= {'sdt_1', 'sdt_2'}
    assert 1 <= int(re.search(r'(\d+) frames? (?:was|were) answered without a tile', err)[1]) <= 2


def test_tile_that_stays_dead_ends_the_run_as_any_node(bringup):
    run = bringup('--scenario', 'example3', '--rate', '30', '--tiles', '2x1')
    run.wait_for_rows(10)
    run.kill('tile_node')
    status, _, err = run.finish()
    assert status == 1
    assert re.search(r'sdt_[12] was killed', err)


@pytest.mark.parametrize(('options', 'words'), [
    (('--tiles', '2'), '2x1'), (('--tiles', '0x1'), '1 to 16'), (('--tiles', '17x1'), '1 to 16'),
    (('--tiles', '2x1', '--composed'), '--composed'),
    (('--tiles', '2x1', '--detector', 'hmm'), 'posterior')])
def test_tiles_that_cannot_be_are_refused_before_the_start(options, words):
    done = run_bringup(*options)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert words in done.stderr
