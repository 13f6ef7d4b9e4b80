# SPDX-License-Identifier: Apache-2.0
"""What the bring-ups of the parts of a run tell each other, as a typed record and as a message."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from lowsnr_common.core.records import Malformed
from lowsnr_common.ros.run_records import count_of
from lowsnr_common.ros.run_records import name_of
from lowsnr_common.ros.run_records import pairs
from lowsnr_common.ros.run_records import stamp_of
from lowsnr_common.ros.run_records import values_of

PARTS = 'parts'
# Stages of a part.
STARTING, RUNNING, ENDED = 'starting', 'running', 'ended'
# States of a node; all but the first are those of a node of the part itself.
ELSEWHERE, AWAY, CONFIGURED, ACTIVE, DONE = 'elsewhere', 'away', 'configured', 'active', 'done'
_STAGES = (STARTING, RUNNING, ENDED)
_STATES = (ELSEWHERE, AWAY, CONFIGURED, ACTIVE, DONE)
_MOST_NODES, _NANO = 1000, 1_000_000_000


@dataclass(frozen=True)
class NodeReport:
    """The state of a node, and how often the part knows that it was started again."""

    state: str = ELSEWHERE
    restarts: int = 0


@dataclass(frozen=True)
class PartReport:
    """
    The state of one part of a run.

    ``part`` is the full name of its bring-up's node, ``options`` the digest of what all parts must
    have in common.  ``published`` counts the frames that the part knows to be published,
    ``newest_ns`` is the latest stamp of theirs [ns], and ``nodes`` are those of the whole run by
    full name.
    """

    part: str
    options: str
    stage: str
    published: int = 0
    newest_ns: int = 0
    nodes: dict[str, NodeReport] = field(default_factory=dict)

    @property
    def own(self) -> set[str]:
        """Full names of the nodes of this part."""
        return {path for path, node in self.nodes.items() if node.state != ELSEWHERE}

    def to_message(self) -> DiagnosticArray:
        """Return the record as a message: a status of the part, and one of each node."""
        message = DiagnosticArray(status=[
            DiagnosticStatus(name=self.part, message=self.stage, values=pairs(
                options=self.options, published=self.published))])
        message.status += [
            DiagnosticStatus(name=path, message=node.state, values=pairs(restarts=node.restarts))
            for path, node in self.nodes.items()]
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(self.newest_ns, _NANO)
        return message

    @classmethod
    def from_message(cls, message: DiagnosticArray) -> PartReport:
        """
        Return the record that a message holds.

        Raises
        ------
        Malformed
            If the stamp is negative, there is no node or more than 1000, keys or states are
            others, a name is longer than 255 letters or occurs twice, or a value is not a count.

        """
        newest_ns = stamp_of(message)
        if not 2 <= len(message.status) <= _MOST_NODES:
            raise Malformed('number of nodes', f'{len(message.status)} statuses, must be 2 to '
                            f'{_MOST_NODES}')
        part, *rest = message.status
        nodes = {name_of(each): _node(each) for each in rest}
        if len(nodes) < len(rest):
            raise Malformed('name of two nodes', 'two nodes have the same name')
        texts = values_of(part, ('options', 'published'))
        return cls(
            name_of(part), texts['options'], _one_of(_STAGES, part.message),
            count_of(texts, 'published'), newest_ns, nodes)


def _node(status: DiagnosticStatus) -> NodeReport:
    return NodeReport(
        _one_of(_STATES, status.message), count_of(values_of(status, ('restarts',)), 'restarts'))


def _one_of(known: tuple[str, ...], word: str) -> str:
    if word not in known:
        raise Malformed('unknown state', f'{word[:40]!r} is not one of {", ".join(known)}')
    return word
