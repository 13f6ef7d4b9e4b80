# SPDX-License-Identifier: Apache-2.0
"""A run in parts: two on one host, and two on hosts that fail each other in several ways."""

import json
import os
import re
import signal
import subprocess
import sys

from graph_runs import own_domain
from graph_runs import ROOT
import pytest
from run_checks import PATIENT
from split_run import ROWS_BEFORE

SPLIT_RUN = ROOT / 'test' / 'support' / 'split_run.py'
NEW_NETWORK = ['unshare', '--map-root-user', '--net']
MOST = ('evaluator', 'tracker', 'sensor')
LOCKSTEP = ('--scenario', 'example3', '--frames', '60', '--lockstep')
FRAMES, RATE_HZ = 600, 30.0
PACED = ('--scenario', 'example3', '--frames', str(FRAMES), '--rate', str(RATE_HZ))
TABLES = ('frames.csv', 'detections.csv', 'tracks.csv', 'truth.csv')


def tables(run):
    """Return the bytes of all tables of a run."""
    return {name: (run.results / name).read_bytes() for name in TABLES}


def test_parts_on_one_host_give_the_bytes_of_the_whole_run(bringup):
    detector = bringup(
        *LOCKSTEP, '--only', 'sdt', '--expect', *MOST, results='detector')
    most = bringup(*LOCKSTEP, '--only', *MOST, '--expect', 'sdt_detector', results='most')
    code, out, err = most.finish()
    assert code == 0, err
    code, _, err = detector.finish()
    assert code == 0, err
    assert not (detector.results / 'summary.json').exists()
    whole = bringup(*LOCKSTEP, results='whole')
    assert whole.finish()[0] == 0
    assert tables(most) == tables(whole)
    assert most.summary()['frames'] == whole.summary()['frames']


def test_evaluator_apart_from_the_source_accounts_for_every_frame(bringup):
    source = bringup(*LOCKSTEP, '--expect', 'evaluator', 'tracker', results='source')
    judge = bringup(
        *LOCKSTEP, '--only', 'evaluator', 'tracker', '--expect', 'sdt_detector', 'sensor',
        results='judge')
    assert judge.finish()[0] == 0
    assert source.finish()[0] == 0
    assert judge.summary()['frames'] == {
        'expected': 60, 'published': 60, 'scored': 60, 'unanswered': 0, 'unseen': 0, 'lost': 0}


def test_composed_chains_that_are_divided_give_the_bytes_of_the_whole_run(bringup):
    options = (*LOCKSTEP, '--detector', 'cdt', 'hmm', '--composed')
    theirs = ('cdt.tracker', 'cdt', 'hmm')
    rest = ('evaluator', 'hmm.tracker', 'sensor')
    some = bringup(*options, '--only', *theirs, '--expect', *rest, results='some')
    most = bringup(*options, '--expect', *theirs, results='most')
    for run in (most, some):
        code, _, err = run.finish()
        assert code == 0, err
    whole = bringup(*options, results='whole')
    assert whole.finish()[0] == 0
    assert tables(most) == tables(whole)


def start_paced(bringup):
    """Return the part with the detector and the rest of a paced run that is under way."""
    detector = bringup(*PACED, '--only', 'sdt', '--expect', *MOST, results='detector')
    most = bringup(*PACED, '--expect', 'sdt', results='most')
    most.wait_for_rows(40)
    return detector, most


def test_part_that_is_interrupted_ends_with_0_and_one_that_comes_back_joins(bringup):
    first, most = start_paced(bringup)
    first.process.send_signal(signal.SIGINT)
    assert first.finish()[0] == 0
    second = bringup(*PACED, '--only', 'sdt', '--expect', *MOST, results='second')
    second.wait_for_restarts(1)
    assert most.finish()[0] == 0
    assert second.finish()[0] == 0
    frames = most.summary()['frames']
    assert frames['published'] == FRAMES == frames['scored'] + frames['unanswered']
    assert frames['unanswered'] > 0
    assert most.summary()['restarts'] == {'sdt_detector': 1}


def test_evaluator_that_is_interrupted_saves_its_scores_and_ends_the_other_parts(bringup):
    detector, most = start_paced(bringup)
    most.process.send_signal(signal.SIGINT)
    assert most.finish()[0] == 130
    assert detector.finish()[0] == 0
    assert most.summary()['frames']['scored'] >= 20


@pytest.mark.parametrize('wrong', [('--seed', '1'), ('--scenario', 'empty')])
def test_part_of_other_options_starts_nothing_and_the_part_that_waits_waits_on(bringup, wrong):
    detector = bringup(*LOCKSTEP, '--only', 'sdt', '--expect', *MOST, results='detector')
    detector.wait_for_nodes(1)
    most = bringup(*LOCKSTEP, *wrong, '--expect', 'sdt', results='wrong')
    code, _, err = most.finish()
    assert code == 1
    assert 'other options' in err
    assert not most.rows()
    most = bringup(*LOCKSTEP, '--expect', 'sdt', results='most')
    assert most.finish()[0] == 0
    code, _, err = detector.finish()
    assert code == 0, err
    assert most.summary()['frames']['scored'] == 60


def test_part_that_does_not_come_is_named(bringup):
    run = bringup(*LOCKSTEP, '--expect', 'sdt', '--expect-within', '3')
    code, _, err = run.finish()
    assert code == 1
    assert 'sdt_detector: expected' in err
    assert '--expect-within' in err


@pytest.fixture
def split(tmp_path, require_program):
    """Return a function that runs two hosts, on one of which something happens."""
    require_program('cc')
    able = subprocess.run([*NEW_NETWORK, 'ip', 'link'], capture_output=True, check=False)
    assert able.returncode == 0, 'this test makes network namespaces, as root or a user who may'
    plain = {key: value for key, value in os.environ.items() if key not in (
        'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS', 'ROS_LOCALHOST_ONLY')}

    def run(event, *options):
        done = subprocess.run(
            [*NEW_NETWORK, sys.executable, str(SPLIT_RUN), str(tmp_path), event, *PACED,
             *options],
            env=plain | {'ROS_DOMAIN_ID': str(own_domain()),
                         'PYTHONPATH': os.pathsep.join(sys.path)},
            capture_output=True, text=True, timeout=900.0, check=False)
        assert done.returncode == 0, done.stderr
        found = json.loads(done.stdout)
        assert found['codes'] == [0, 0], found['log']
        frames = found['frames']
        assert frames['published'] == FRAMES == sum(
            frames[key] for key in ('scored', 'unanswered', 'unseen', 'lost'))
        return found
    return run


@pytest.mark.slow
@pytest.mark.parametrize('event', ['unplugged', 'clocks', 'lossy'])
def test_hosts_lose_no_frame_by_a_short_outage_wrong_clocks_or_lost_packets(split, event):
    found = split(event, *PATIENT)
    assert found['frames']['scored'] == FRAMES
    assert found['restarts'] == {}


def test_host_that_is_killed_comes_back_and_only_its_outage_lacks_answers(split):
    found = split('killed')
    lacking = found['lacking']
    assert found['restarts'] == {'sdt_detector': 1}
    assert len(lacking) == found['frames']['unanswered'] > 0
    assert lacking == list(range(lacking[0], lacking[-1] + 1))  # the outage, and no other frame
    # What came in the second after the evaluator's part knew of it may still be lost.
    assert len(lacking) <= RATE_HZ * (found['away_s'] + 1.0)


def test_host_of_a_tile_that_is_killed_comes_back_and_every_frame_is_answered(split):
    found = split('killed', '--tiles', '1x2')
    assert found['restarts'] == {'sdt_2': 1}
    assert (found['frames']['scored'], found['lacking']) == (FRAMES, [])
    without = re.search(r'(\d+) frames? (?:was|were) answered without a tile', found['log'])
    # Frames that were scored before its death were answered with it: two rows of each.
    assert 0 < int(without[1]) <= FRAMES - ROWS_BEFORE // 2
