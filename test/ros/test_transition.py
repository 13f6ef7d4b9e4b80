# SPDX-License-Identifier: Apache-2.0
"""Transitions that bring-up asks for over its line: made, or rejected, and answered either way."""

from bringup_end import BringupEnd
from lifecycle_msgs.msg import State
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.msg import TransitionEvent
from lowsnr_bringup.ros.transition import PendingTransition
from lowsnr_track.tracker_node import TrackerNode
import pytest
from rclpy.parameter import Parameter
from vision_msgs.msg import Detection2DArray

CONFIGURE, ACTIVATE = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
DEACTIVATE = Transition.TRANSITION_DEACTIVATE


@pytest.fixture
def ask(context, spin):
    """Return a function that asks a node for a transition, and returns whether it made it."""
    node = TrackerNode(context=context, parameter_overrides=[
        Parameter('rows', value=16), Parameter('cols', value=24),
        Parameter('autostart', value=False)])
    node.create_publisher(Detection2DArray, 'detections', 10)  # a node of a run waits for it
    spin(lambda: True, node)
    with BringupEnd(node) as bringup:
        def ask_for(transition):
            before = len(bringup.heard('change_state', TransitionEvent))
            pending = PendingTransition(bringup.line, transition)
            assert pending.poll() is None
            spin(lambda: len(bringup.heard('change_state', TransitionEvent)) > before)
            pending.answer(bringup.heard('change_state', TransitionEvent)[-1])
            return pending.poll()

        ask_for.state = lambda: bringup.heard('change_state', TransitionEvent)[-1].goal_state.id
        yield ask_for
    node.destroy_node()


def test_node_makes_transitions_and_answers_with_its_state(ask):
    for transition, state in (
            (CONFIGURE, State.PRIMARY_STATE_INACTIVE), (ACTIVATE, State.PRIMARY_STATE_ACTIVE),
            (DEACTIVATE, State.PRIMARY_STATE_INACTIVE), (ACTIVATE, State.PRIMARY_STATE_ACTIVE)):
        assert ask(transition)
        assert ask.state() == state


def test_transition_that_the_state_does_not_allow_is_rejected_and_ends_nothing(ask):
    assert ask(ACTIVATE) is False
    assert ask.state() == State.PRIMARY_STATE_UNCONFIGURED
    assert ask(CONFIGURE)


def test_transition_that_an_operator_has_made_counts_as_made(ask):
    assert ask(CONFIGURE)
    assert ask(CONFIGURE)
