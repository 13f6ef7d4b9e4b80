# SPDX-License-Identifier: Apache-2.0
"""A run is refused where nodes of its names answer, whatever the lock file says."""

import time

from lowsnr_bringup.plan.graph import run_nodes
from lowsnr_bringup.ros.domain_guard import DomainGuard
from lowsnr_bringup.ros.domain_guard import DomainTaken
import pytest
from rclpy.node import Node
from ros_nodes import node_domain
from ros_nodes import ros_context

PATHS = [node.path for node in run_nodes(['cdt', 'sdt'])]


@pytest.fixture
def bringup():
    """Return bring-up's own node."""
    with ros_context(node_domain()) as context:
        node = Node('bringup', context=context)
        yield node
        node.destroy_node()


def taken(bringup, *others, check=DomainGuard.check_before_start):
    """Return the names that are taken where others have nodes of these names and namespaces."""
    with ros_context(node_domain()) as context:
        nodes = [Node(name, namespace=space, context=context) for name, space in others]
        try:
            check(DomainGuard(bringup, PATHS))
        except DomainTaken as error:
            return error.names
        finally:
            for node in nodes:
                node.destroy_node()
    return []


def test_strangers_of_other_names_are_no_run(bringup):
    assert taken(bringup) == []
    assert taken(bringup, ('rviz', ''), ('tracker', ''), ('tracker', '/mine')) == []


def test_node_of_the_same_full_name_is_named(bringup):
    assert taken(bringup, ('tracker', '/sdt'), ('rviz', '')) == ['/sdt/tracker']


def test_another_bringup_is_named_also_while_the_own_nodes_start(bringup):
    def check_for_long(guard):
        for _ in range(1000):
            guard.check()
            time.sleep(0.01)
    assert taken(
        bringup, ('bringup', ''), ('evaluator', ''), check=check_for_long) == ['/bringup']


def test_refusal_is_one_line_with_domain_and_names():
    text = str(DomainTaken(7, {'/b', '/a'}))
    assert len(text.splitlines()) == 1
    assert ' 7:' in text
    assert '/a, /b' in text
