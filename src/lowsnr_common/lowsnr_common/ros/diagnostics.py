# SPDX-License-Identifier: Apache-2.0
"""The status of a node in ``/diagnostics``: its counts, times, and faults by reason."""

from __future__ import annotations

from collections import Counter
from collections import defaultdict
from collections import deque
from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue
from lowsnr_common.settings.text import printable

# Messages received, published and rejected; rejected as too late; dropped by the middleware.
ALWAYS = ('in', 'out', 'refused', 'late', 'lost')
# The number of durations kept of each input.
_TIMED = 1000
_FAULT = 'fault: '


@dataclass(frozen=True)
class Fault:
    """
    Something wrong with what a node receives, publishes or writes.

    Parameters
    ----------
    subject
        Name of the topic, or what else it is about.
    reason
        The same short phrase for all such faults, by which programs tell them apart: one of the
        constants of :mod:`lowsnr_common.ros.connections` or :mod:`lowsnr_common.ros.inputs`, or
        the reason of a :class:`lowsnr_common.core.records.Malformed`.
    text
        A sentence for people, with the values of this fault.

    """

    subject: str
    reason: str
    text: str

    def __post_init__(self) -> None:
        """Make what strangers have named printable: people read it in terminals and logs."""
        for name in ('subject', 'text'):
            object.__setattr__(self, name, printable(getattr(self, name)))

    @property
    def key(self) -> str:
        """Return what tells faults apart: subject and reason."""
        return f'{self.subject} {self.reason}'

    def __str__(self) -> str:
        return f'{self.subject}: {self.text}'


def faults_of(status: DiagnosticStatus) -> dict[str, str]:
    """Return the faults that a status reports, sentences by :attr:`Fault.key`."""
    return {
        item.key.removeprefix(_FAULT): item.value for item in status.values
        if item.key.startswith(_FAULT)}


class Health:
    """
    The counts, times and faults of a node.

    ``counts`` are those since it started, ``fault`` is the last one since the last status.
    """

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter(dict.fromkeys(ALWAYS, 0))
        self.fault: Fault | None = None
        self._spent_ms: dict[str, deque[float]] = defaultdict(lambda: deque(maxlen=_TIMED))

    def spent(self, topic: str, seconds: float) -> None:
        """Add the time that the work on a message of a topic took [s]."""
        self._spent_ms[topic].append(1e3 * seconds)

    def status(
        self, name: str, lasting: Sequence[Fault], facts: Mapping[str, str],
    ) -> DiagnosticStatus:
        """
        Return the status of a node, and forget its last fault.

        Parameters
        ----------
        name
            Full name of the node.
        lasting
            Faults that exist now: with any the level is ERROR.  It is WARN if there was another
            since the last status, such as a rejected, late or lost message.
        facts
            Further values by key.

        """
        values = {key: str(count) for key, count in sorted(self.counts.items())}
        for topic, spent in self._spent_ms.items():
            values[f'{topic} median [ms]'] = f'{median(spent):.3f}'
            values[f'{topic} longest [ms]'] = f'{max(spent):.3f}'
        faults = [*lasting, self.fault] if self.fault else [*lasting]
        values |= {**facts, **{f'{_FAULT}{fault.key}': str(fault) for fault in faults}}
        level = DiagnosticStatus.WARN if self.fault else DiagnosticStatus.OK
        self.fault = None
        return DiagnosticStatus(
            level=DiagnosticStatus.ERROR if lasting else level, name=name,
            message='; '.join(map(str, faults)),
            values=[KeyValue(key=key, value=value) for key, value in values.items()])
