# SPDX-License-Identifier: Apache-2.0
"""A node makes or rejects any requested transition and lives on, except after a shutdown."""

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from lowsnr_eval.evaluator_node import EvaluatorNode
from lowsnr_track.tracker_node import TrackerNode
import pytest
from rclpy.parameter import Parameter

CONFIGURE, CLEANUP = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_CLEANUP
ACTIVATE, DEACTIVATE = Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_DEACTIVATE


def change(client, transition):
    """Ask for a transition as ``ros2 lifecycle set`` does; return whether it was made."""
    request = ChangeState.Request(transition=Transition(id=transition))
    return client.call(ChangeState, 'change_state', request).success


def test_transition_that_the_state_does_not_allow_is_rejected(started):
    client = started(TrackerNode)
    for transition in (CONFIGURE, ACTIVATE, CLEANUP, 99):
        assert not change(client, transition)
    assert len(client.follow((3.0, 3.0))) == 0  # answered; one detection confirms no track


def test_node_can_be_configured_again(started):
    client = started(TrackerNode)
    client.follow((3.0, 3.0))
    for transition in (DEACTIVATE, CLEANUP, CONFIGURE, ACTIVATE) * 2:
        assert change(client, transition)
    before = len(client.tracks)
    for _ in range(3):
        client.follow((3.0, 3.0))
    assert len(client.tracks) == before + 3  # each is answered once
    assert client.node.counts['late'] == 0


@pytest.mark.parametrize('lives', [0, 1])
def test_reason_why_a_node_is_not_configured_is_logged(context, log, tmp_path, lives):
    (tmp_path / 'frames.csv').write_text('1,2,3\n1,2,3\n')
    values = {'results': str(tmp_path), 'lives': lives}
    node = EvaluatorNode(context=context, parameter_overrides=[
        Parameter(name, value=value) for name, value in values.items()])
    assert not node.autostart()
    assert any(str(tmp_path) in line for line in log)
    node.destroy_node()
