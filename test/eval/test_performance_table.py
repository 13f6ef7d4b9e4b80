# SPDX-License-Identifier: Apache-2.0
"""The table of performance: what a row says where it was measured, and where it was not."""

from pathlib import Path
import subprocess
import sys

from graph_runs import own_domain
from graph_runs import ROOT
from lowsnr_common.images.receive_buffer import WANTED_BYTES
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / 'benchmarks'))
import round_trip  # noqa: E402
from rows.host_rows import longest_block  # noqa: E402
from rows.row import Figure  # noqa: E402
from rows.row import Measurement  # noqa: E402
from rows.row import need_receive_buffer  # noqa: E402
from rows.row import NotMeasured  # noqa: E402

KINDS = (
    'start, warm', 'detector_node killed', 'tracker_node killed', '1024 x 1024 float32, lockstep',
    'frame to track, over 3 bare hops', 'composed chain', '4096 x 4096 of 16 bits', 'two hosts',
    'first calibration, 20 x 20, any detector', 'first calibration, 96 x 96, hmm', 'SDT s_m=5',
    'HMM order 2', 'MMTBD2', 'PDA-MMPF')


def table(*arguments):
    """Run the command."""
    return subprocess.run(
        [sys.executable, str(ROOT / 'benchmarks' / 'table.py'), *arguments], text=True,
        capture_output=True, timeout=300.0, check=False)


def test_every_kind_of_row_is_in_the_table_and_no_name_twice():
    done = table('--list')
    assert done.returncode == 0, done.stderr
    names = done.stdout.splitlines()
    assert len(set(names)) == len(names)
    for kind in KINDS:
        assert any(kind in name for name in names), kind


def test_rows_are_chosen_by_name_and_written(tmp_path):
    done = table('--only', 'sdt s_m=1,', '--seconds', '0.01', '--rounds', '1', '--out',
                 str(tmp_path))
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert [line.split(' | ')[0] for line in lines[2:3]] == [
        '| SDT s_m=1, 256 x 256, over copy of 1 float32 planes']
    assert (tmp_path / 'table.md').read_text().splitlines() == lines[:3]
    assert table('--only', 'nothing').returncode == 2


@pytest.mark.parametrize(('found', 'cell', 'met'), [
    (Figure('2 s', True), '2 s', 'yes'), (Figure('4 s', False), '4 s', 'no'),
    (Figure('a | b'), 'a / b', '')])
def test_row_says_whether_the_goal_is_met(found, cell, met):
    row, measured = Measurement('what', '3 s', lambda: found).row()
    assert measured
    assert row.met is found.met
    assert row.line() == f'| what | {cell} | 3 s | {met} |'


@pytest.mark.parametrize('error', [
    NotMeasured('no right'), AssertionError('no\nright'), TimeoutError('no right'),
    subprocess.TimeoutExpired('no right', 3.0)])
def test_row_that_cannot_be_measured_says_why_and_meets_no_goal(error):
    def measure():
        raise error

    row, measured = Measurement('what', '3 s', measure).row()
    assert not measured
    assert row.met is None
    assert row.measured.startswith('not measured: ')
    assert 'no right' in row.measured


def test_error_of_the_program_itself_is_not_hidden_in_a_row():
    with pytest.raises(ZeroDivisionError):
        Measurement('what', '', lambda: Figure(str(1 / 0))).row()


def test_frames_that_sockets_cannot_hold_are_refused_with_the_remedy(tmp_path):
    limit = tmp_path / 'rmem_max'
    need_receive_buffer(1000, limit)  # another system: there is no such limit
    limit.write_text('1000\n')
    need_receive_buffer(1000, limit)
    with pytest.raises(NotMeasured, match=f'rmem_max={WANTED_BYTES}'):
        need_receive_buffer(1001, limit)


@pytest.mark.parametrize(('numbers', 'length'), [
    ([], 0), ([7], 1), ([3, 5, 9], 1), ([1, 2, 3, 7, 8], 3), ([1, 4, 5, 6, 7], 4)])
def test_outage_is_the_longest_run_of_consecutive_frames(numbers, length):
    assert longest_block(numbers) == length


def test_round_trip_without_an_answer_ends(monkeypatch):
    monkeypatch.setattr(round_trip, 'WITHIN_S', 0.5)
    monkeypatch.setattr(round_trip, 'echo', lambda: None)
    monkeypatch.setenv('ROS_DOMAIN_ID', str(own_domain(-2)))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    with pytest.raises(TimeoutError, match='not found within 0.5 s'):
        round_trip._measure(8, 1)
