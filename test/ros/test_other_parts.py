# SPDX-License-Identifier: Apache-2.0
"""What the bring-ups of parts of a run tell each other, and what they make of it."""

from contextlib import ExitStack
from dataclasses import replace
import time

from diagnostic_msgs.msg import DiagnosticArray
from lowsnr_bringup.plan.graph import run_nodes
from lowsnr_bringup.plan.parts import part_of
from lowsnr_bringup.ros.bringup_node import bringup_node
from lowsnr_bringup.ros.heard.other_parts import AWAY_AFTER_S
from lowsnr_bringup.ros.heard.other_parts import OtherParts
from lowsnr_bringup.ros.heard.part_report import ACTIVE
from lowsnr_bringup.ros.heard.part_report import ELSEWHERE
from lowsnr_bringup.ros.heard.part_report import ENDED
from lowsnr_bringup.ros.heard.part_report import NodeReport
from lowsnr_bringup.ros.heard.part_report import PartReport
from lowsnr_bringup.ros.heard.part_report import PARTS
from lowsnr_bringup.ros.heard.part_report import RUNNING
from lowsnr_bringup.ros.heard.part_report import STARTING
from lowsnr_common.core.records import Malformed
import pytest
from ros_nodes import node_domain

NODES = run_nodes(['sdt'])
EVALUATOR, TRACKER, DETECTOR, SENSOR = NODES
MOST = part_of(NODES, {}, [], ['sdt'])
REST = part_of(NODES, {}, ['sdt'], ['evaluator', 'tracker', 'sensor'])
REPORT = PartReport('/bringup', MOST.options, RUNNING, 7, 3 * 10**9, {
    **{path: NodeReport(ACTIVE) for path in ('/evaluator', '/tracker', '/sensor')},
    '/sdt_detector': NodeReport(ELSEWHERE, 2)})


@pytest.fixture
def rest(monkeypatch):
    """Return the part with the detector, on a domain of its own, with a clock that is set."""
    monkeypatch.setenv('ROS_DOMAIN_ID', str(node_domain()))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    now = [0.0]
    with bringup_node(REST.manager) as node:
        parts = OtherParts(node, REST, lambda: now[0])
        parts.pass_s = lambda seconds: now.__setitem__(0, now[0] + seconds)
        yield parts


def test_report_is_the_same_after_the_message():
    assert PartReport.from_message(REPORT.to_message()) == REPORT
    assert REPORT.own == {'/evaluator', '/tracker', '/sensor'}


def unsound():
    """Yield messages that are no report."""
    yield DiagnosticArray()
    for change in (
            lambda m: setattr(m.header.stamp, 'sec', -1), lambda m: m.status.append(m.status[1]),
            lambda m: setattr(m.status[0], 'message', 'asleep'),
            lambda m: setattr(m.status[1], 'message', ''),
            lambda m: setattr(m.status[1].values[0], 'value', '-1'),
            lambda m: setattr(m.status[0].values[0], 'key', 'option'),
            lambda m: setattr(m.status[2], 'name', 300 * 'x')):
        message = REPORT.to_message()
        change(message)
        yield message


@pytest.mark.parametrize('message', unsound())
def test_unsound_report_is_malformed(message):
    with pytest.raises(Malformed):
        PartReport.from_message(message)


def test_what_a_part_reports_is_known_until_it_is_away(rest, capsys):
    assert (rest.running, rest.over, rest.newest_ns) == (False, False, -1)
    rest.hear(REPORT.to_message())
    assert (rest.running, rest.over, rest.published) == (True, False, 7)
    assert rest.newest_ns == 3 * 10**9
    assert rest.state(SENSOR) == ACTIVE
    assert rest.restarts('/sdt_detector') == 2
    rest.pass_s(AWAY_AFTER_S + 0.1)
    assert rest.state(SENSOR) == ELSEWHERE
    for _ in range(3):
        rest.watch()
    rest.hear(REPORT.to_message())
    assert rest.state(SENSOR) == ACTIVE
    away, back = capsys.readouterr().err.splitlines()
    assert 'not heard' in away
    assert 'again' in back


def test_run_is_over_when_the_evaluators_part_ends_but_not_by_the_end_of_an_earlier_run(rest):
    rest.hear(replace(REPORT, stage=ENDED).to_message())
    assert not rest.over
    rest.hear(replace(REPORT, stage=STARTING).to_message())
    assert not rest.running
    rest.hear(replace(REPORT, stage=ENDED).to_message())
    assert rest.over


@pytest.mark.parametrize(('change', 'words'), [
    ({}, ''), ({'options': 'f00'}, 'other options'),
    ({'nodes': {'/sdt_detector': NodeReport(ACTIVE)}}, '/sdt_detector runs in two parts')])
def test_part_that_is_not_of_this_run_is_refused_at_the_start_and_named_once(
        rest, capsys, change, words):
    rest.hear(replace(REPORT, **change).to_message())
    fault = rest.wait_for_reports(lambda: rest.pass_s(2.0))
    assert words in fault
    assert bool(words) == bool(fault)
    assert rest.running == (not words)
    for _ in range(3):
        rest.watch()
    assert capsys.readouterr().err.count('does not heed') == bool(words)


def test_part_that_is_refused_changes_nothing_of_a_run(rest):
    rest.hear(REPORT.to_message())
    for change in ({'options': 'f00'}, {'part': '/bringup_tracker'},
                   {'nodes': {'/evaluator': NodeReport(ACTIVE),
                              '/sdt_detector': NodeReport(ACTIVE)}}):
        wrong = replace(REPORT, stage=STARTING, published=99, newest_ns=9 * 10**9, **change)
        for stage in (STARTING, ENDED):
            rest.hear(replace(wrong, stage=stage).to_message())
    assert (rest.running, rest.over, rest.published) == (True, False, 7)
    assert rest.newest_ns == 3 * 10**9
    assert rest.state(SENSOR) == ACTIVE


def test_nodes_of_a_part_that_is_away_may_come_in_another_part(rest):
    rest.hear(REPORT.to_message())
    rest.pass_s(AWAY_AFTER_S + 0.1)
    assert not rest.running
    rest.hear(replace(REPORT, part='/bringup_tracker').to_message())
    assert rest.running
    assert rest.state(SENSOR) == ACTIVE


def hear_until(rest, condition):
    """Take reports until a condition holds."""
    until = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < until
        for topic, message in rest.take():
            assert topic == PARTS
            rest.hear(message)


def test_parts_hear_each_other_whoever_comes_first(rest):
    with ExitStack() as stack:
        most = OtherParts(stack.enter_context(bringup_node(MOST.manager)), MOST)
        most.report(REPORT)
        hear_until(rest, lambda: rest.running)


def test_end_is_heard_by_a_part_that_reports_before_it_listens(rest):
    with ExitStack() as stack:
        most = OtherParts(stack.enter_context(bringup_node(MOST.manager)), MOST)
        most.report(REPORT)
        hear_until(rest, lambda: rest.running)
        most.report(replace(REPORT, stage=ENDED))
        most.leave()  # all who listen have received it
        own = PartReport('/bringup_sdt_detector', REST.options, RUNNING, nodes={
            '/sdt_detector': NodeReport(ACTIVE)})
        for restarts in range(5):
            rest.report(replace(own, nodes={'/sdt_detector': NodeReport(ACTIVE, restarts)}))
            rest.leave()
    hear_until(rest, lambda: rest.over)


def test_whole_run_says_and_hears_nothing(rest):
    with bringup_node() as node:
        before = len(list(node.publishers)), len(list(node.subscriptions))
        parts = OtherParts(node, part_of(NODES, {}, [], []))
        parts.report(REPORT)
        parts.leave()
        assert (len(list(node.publishers)), len(list(node.subscriptions))) == before
        assert not list(parts.take())
    assert not parts.running
