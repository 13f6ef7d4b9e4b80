# SPDX-License-Identifier: Apache-2.0
"""A running graph whose parameters another program sets, over DDS, while frames flow."""

import math
import re
import signal

from graph_client import GraphClient
from graph_runs import own_domain
import pytest
from run_checks import check_cut_off

DETECTOR = '/cdt_detector'
FRAMES = 300


@pytest.fixture
def client():
    """Return a client of the test's graph that subscribes to its detections alone."""
    with GraphClient(own_domain(), topics=['/detections']) as started:
        yield started


def declared_share(client, first):
    """Return the share of `FRAMES` frames, from a number on, with a declaration."""
    client.wait(lambda: sum(number >= first for number in client.declared) >= FRAMES)
    seen = sorted(number for number in client.declared if number >= first)[:FRAMES]
    return sum(client.declared[number] for number in seen) / FRAMES


def recent_share(client):
    """Return the share of the newest 100 frames with a declaration."""
    newest = sorted(client.declared)[-100:]
    return sum(client.declared[number] for number in newest) / 100


def logged(run, pattern, label='cdt_detector'):
    """Return all matches of a pattern in the log of a node."""
    path = run.results / 'log' / f'{label}.log'
    return re.findall(pattern, path.read_text() if path.is_file() else '')


def about(prob):
    """Return what a measured share of empty frames must equal: 4 sigma, calibration included."""
    trials = 1.0 / (1.0 / FRAMES + 1.0 / (400.0 / prob))
    return pytest.approx(prob, abs=4.0 * math.sqrt(prob * (1.0 - prob) / trials))


def test_false_alarm_rate_set_on_a_running_detector_is_the_one_of_its_frames(
        bringup, client):
    run = bringup('--detector', 'cdt', '--scenario', 'empty', '--snr', '6', '--loop',
                  '--lockstep', '--set', 'cdt.false_alarm_prob=0.02')
    assert declared_share(client, 1) == about(0.02)
    # The reason names the parameter that stands in the way.
    for name, value, culprit in (
            ('false_alarm_prob', 1.5, 'false_alarm_prob'), ('threshold', 9.0, 'operating_point'),
            ('alpha', 0.1, 'alpha')):
        accepted, reason = client.set(DETECTOR, name, value)
        assert not accepted
        assert culprit in reason
        assert logged(run, rf'\b{culprit}\b')
    assert declared_share(client, max(client.declared)) == about(0.02)
    assert client.set(DETECTOR, 'false_alarm_prob', 0.3) == (True, '')
    client.wait(lambda: recent_share(client) > 0.15)
    assert declared_share(client, max(client.declared) + 1) == about(0.3)
    assert client.get(DETECTOR, 'false_alarm_prob', 'threshold', 'alpha') == [0.3, 4.595, 0.01]
    assert logged(run, r'false_alarm_prob = 0\.3 .*0\.02')
    assert client.set('/tracker', 'detection.probability', 0.7) == (True, '')
    assert client.get('/tracker', 'detection.probability') == [0.7]
    client.wait(lambda: logged(run, r'detection\.probability = 0\.7', 'tracker'))
    accepted, reason = client.set('/evaluator', 'gate_cells', 9.0)
    assert not accepted
    assert 'gate_cells' in reason
    run.process.send_signal(signal.SIGINT)
    code, _, err = run.finish()
    assert (code, 'Traceback' in err) == (130, False)
    check_cut_off(run)


def test_a_detector_started_again_has_what_was_set_while_it_ran(bringup, client):
    run = bringup('--detector', 'cdt', '--scenario', 'empty', '--loop', '--lockstep')
    run.wait_for_rows(20)
    assert client.set(DETECTOR, 'operating_point', 'manual') == (True, '')
    assert client.set(DETECTOR, 'threshold', -50.0) == (True, '')
    # Every frame declares, not one by chance.
    client.wait(lambda: len(client.declared) > 10 and all(
        client.declared[number] for number in sorted(client.declared)[-10:]))
    run.kill('detector_node')
    run.wait_for_restarts(1)
    back = max(client.declared) + 1
    client.wait(lambda: max(client.declared) > back + 50)
    # Below all noise: every frame declares.
    assert not [number for number, declares in client.declared.items()
                if number >= back and not declares]
    run.process.send_signal(signal.SIGINT)
    assert run.finish()[0] == 130
