# SPDX-License-Identifier: Apache-2.0
"""All nodes of a graph become active in order, whatever dies or is rejected meanwhile."""

from types import SimpleNamespace

from lowsnr_bringup.plan.graph import run_nodes
from lowsnr_bringup.plan.parts import Part
from lowsnr_bringup.ros.graph_start import GraphStart
from lowsnr_bringup.ros.manager import ACTIVATE
from lowsnr_bringup.ros.manager import CONFIGURE
from lowsnr_bringup.ros.manager import GraphFailure
import numpy as np
import pytest

NODES = run_nodes(['cdt', 'sdt'], viewed=True, recorded=True)
STEPS_TO_ANSWER = 3


class Graph:
    """A graph whose nodes answer some steps after they are asked, with a clock of its own."""

    def __init__(self):
        self.reports, self.states = self, {}
        self.now_s, self.answers, self.pids = 0.0, True, iter(range(100, 10_000))
        self.members = {node: self.process(node) for node in NODES}
        self.state = dict.fromkeys(NODES, 0)
        self.asked, self.made = [], []  # node and transition
        self.rejections = {}  # how many requests for a transition a node rejects still
        self.start = GraphStart(self, self, Part(tuple(NODES)), clock=lambda: self.now_s)

    def process(self, node):
        """Return a new process of a node."""
        process = SimpleNamespace(pid=next(self.pids), status=None)
        process.poll = lambda: process.status
        return SimpleNamespace(node=node, process=process)

    def member(self, node):
        """Return the process of a node."""
        return self.members[node]

    def hear(self, path, process):
        """Take a sign of life."""

    def request(self, node, transition):
        """Return a request that the present process of the node answers later."""
        self.asked.append((node, transition))
        if transition == ACTIVATE:  # no subscriber of the node may be inactive
            before = NODES[:NODES.index(node)]
            assert all(self.state[each] == 2 for each in before)
            assert min(self.state.values()) >= 1
        member, due_s = self.members[node], self.now_s + STEPS_TO_ANSWER

        def poll():
            if self.now_s < due_s or not self.answers or self.members[node] is not member:
                return None
            if self.rejections.get((node, transition), 0) > 0:
                self.rejections[node, transition] -= 1
                return False
            assert self.state[node] == (transition == ACTIVATE), (node, transition)
            self.state[node] += 1
            self.made.append((node, transition))
            return True
        return SimpleNamespace(poll=poll)

    def step(self):
        """Let a second pass; return whether all nodes are active."""
        self.now_s += 1.0
        return self.start.step()

    def run(self, steps=200):
        """Run until all nodes are active; fail after so many steps."""
        assert any(self.step() for _ in range(steps))
        assert set(self.state.values()) == {2}

    def die(self, node, status=-9):
        """Have the process of a node die."""
        self.members[node].process.status = status
        self.state[node] = 0

    def replace(self, node):
        """Start a node again."""
        self.members[node] = self.process(node)


def test_all_are_configured_at_once_and_then_activated_in_order():
    graph = Graph()
    graph.run()
    assert {node for node, _ in graph.made[:len(NODES)]} == set(NODES)
    assert graph.made[len(NODES):] == [(node, ACTIVATE) for node in NODES]


def test_node_is_asked_in_the_step_in_which_the_answer_before_has_come():
    graph = Graph()
    graph.run()
    assert graph.now_s == 1 + STEPS_TO_ANSWER * (1 + len(NODES))


def test_nodes_that_die_at_any_step_become_active_in_order_again(seed):
    for trial in range(200):
        rng, graph, away = np.random.default_rng([seed, trial]), Graph(), {}
        for step in range(60):
            if rng.random() < 0.2 and len(away) < 3:
                node = NODES[rng.integers(len(NODES))]
                if node not in away:
                    graph.die(node)
                    away[node] = step + int(rng.integers(1, 6))
            for node, due in list(away.items()):
                if step >= due:
                    graph.replace(node)
                    del away[node]
            done = graph.step()
            assert not (done and away)
            if done:
                break
        for node in away:
            graph.replace(node)
        if not done:
            graph.run()
        assert set(graph.state.values()) == {2}


def test_a_source_that_is_done_at_once_counts_as_active():
    graph = Graph()
    while (NODES[-1], ACTIVATE) not in graph.asked:
        assert not graph.step()
    graph.members[NODES[-1]].process.status = 0
    assert graph.step()


@pytest.mark.parametrize('transition', [CONFIGURE, ACTIVATE])
def test_a_rejection_ends_a_start_in_which_nothing_died(transition):
    graph = Graph()
    graph.rejections[NODES[2], transition] = 1
    with pytest.raises(GraphFailure, match=NODES[2].label):
        graph.run()


def test_a_node_that_waited_in_vain_for_one_that_died_is_asked_again():
    graph = Graph()
    graph.rejections[NODES[2], ACTIVATE] = 2
    for _ in range(2):
        graph.step()
    graph.die(NODES[1])
    graph.step()
    graph.replace(NODES[1])
    graph.run()


def test_a_node_that_does_not_answer_is_named_ever_more_seldom_and_ends_the_start(capsys):
    graph = Graph()
    graph.answers = False
    with pytest.raises(GraphFailure, match='600'):
        graph.run(steps=700)
    lines = capsys.readouterr().err.splitlines()
    assert [int(line.split('(')[1].split()[0]) for line in lines] == [
        10, 20, 40, 80, 160, 320]
    assert all(node.label in line for line in lines for node in NODES)


def test_nodes_of_another_part_are_waited_for_in_the_order_of_the_run():
    graph = Graph()
    expected = frozenset(NODES[2:5])
    reported = dict.fromkeys(expected, 'away')
    graph.parts = SimpleNamespace(state=reported.get)
    graph.start = GraphStart(graph, graph, Part(tuple(NODES), expected), 100.0,
                             lambda: graph.now_s)
    graph.state |= dict.fromkeys(expected, 1)
    assert not any(graph.step() for _ in range(20))
    assert {transition for _, transition in graph.made} == {CONFIGURE}
    reported.update(dict.fromkeys(expected, 'configured'))
    assert not any(graph.step() for _ in range(20))
    assert graph.made[-2:] == [(node, ACTIVATE) for node in NODES[:2]]
    reported.update(dict.fromkeys(expected, 'active'))
    graph.state |= dict.fromkeys(expected, 2)
    assert any(graph.step() for _ in range(200))
    assert set(graph.state.values()) == {2}


def test_part_that_does_not_come_ends_the_start():
    graph = Graph()
    graph.parts = SimpleNamespace(state=lambda _: 'elsewhere')
    graph.start = GraphStart(graph, graph, Part(tuple(NODES), frozenset(NODES[:1])), 20.0,
                             lambda: graph.now_s)
    with pytest.raises(GraphFailure, match='--expect-within'):
        graph.run(50)


@pytest.mark.parametrize('late_s', [3.0, 10.0])
def test_start_of_a_part_ends_when_the_run_turns_out_to_be_under_way(late_s):
    graph, expected = Graph(), frozenset(NODES[:1])
    graph.parts = SimpleNamespace(state=lambda _: 'configured', running=False)
    graph.start = GraphStart(
        graph, graph, Part(tuple(NODES), expected), 100.0, lambda: graph.now_s)

    def spin(_):
        graph.now_s += 1.0
        graph.parts.running = graph.now_s > late_s
    graph.spin = spin
    assert graph.start.run() is False


def test_start_goes_on_where_another_part_has_seen_all_nodes_become_active_first():
    graph, expected = Graph(), frozenset(NODES[:1])
    reported = ['active']
    graph.parts = SimpleNamespace(state=lambda _: reported[0], running=False)
    graph.start = GraphStart(
        graph, graph, Part(tuple(NODES), expected), 100.0, lambda: graph.now_s)
    graph.state |= dict.fromkeys(expected, 2)

    def spin(_):
        graph.now_s += 1.0
        if all(graph.state[node] == 2 for node in NODES):
            graph.parts.running, reported[0] = True, 'active'
        elif graph.now_s > 3.0:
            reported[0] = 'active'
    graph.spin = spin
    assert graph.start.run() is True
