"""A transition is made once, also where the answer to the request is lost."""

from types import SimpleNamespace

from lifecycle_msgs.msg import State
from lifecycle_msgs.msg import Transition
from lowsnr_bringup.ros import transition
from lowsnr_bringup.ros.transition import PendingTransition
import pytest


class Server:
    """The services of a node, whose answers may be lost."""

    def __init__(self, losses=0, loses_request=False, refuses=False):
        self.state = State.PRIMARY_STATE_UNCONFIGURED
        self.losses, self.loses_request, self.refuses = losses, loses_request, refuses

    def client(self, handle):
        """Return a client whose calls the handler answers at once, or never."""
        def call(request):
            lost, self.losses = self.losses > 0, self.losses - 1
            answer = None if lost and self.loses_request else handle(request)
            return SimpleNamespace(done=lambda: not lost, result=lambda: answer)
        return SimpleNamespace(service_is_ready=lambda: True, call_async=call)

    def change(self, request):
        """Make the transition where it can be made from the present state."""
        possible = self.state == State.PRIMARY_STATE_UNCONFIGURED and not self.refuses
        if possible:
            self.state = State.PRIMARY_STATE_INACTIVE
        return SimpleNamespace(success=possible)

    def get(self, _):
        """Return the state."""
        return SimpleNamespace(current_state=SimpleNamespace(id=self.state))


@pytest.mark.parametrize('server', [
    Server(), Server(losses=1), Server(losses=3), Server(losses=1, loses_request=True),
    Server(losses=4, loses_request=True)])
def test_transition_is_made_whatever_is_lost(monkeypatch, server):
    monkeypatch.setattr(transition, '_ASK_AGAIN_AFTER_S', 0.0)
    assert outcome(server) is True
    assert server.state == State.PRIMARY_STATE_INACTIVE


@pytest.mark.parametrize('losses', [0, 1, 2])
def test_refusal_is_known(monkeypatch, losses):
    monkeypatch.setattr(transition, '_ASK_AGAIN_AFTER_S', 0.0)
    assert outcome(Server(losses=losses, refuses=True)) is False


def outcome(server):
    """Return how configuring the server ends."""
    pending = PendingTransition(
        server.client(server.change), server.client(server.get), Transition.TRANSITION_CONFIGURE)
    for _ in range(50):
        if (made := pending.poll()) is not None:
            return made
    return None
