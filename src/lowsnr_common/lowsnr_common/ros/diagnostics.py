"""What a node counts, how long its work takes and what troubles it."""

from __future__ import annotations

from collections import Counter
from collections import defaultdict
from collections import deque
from collections.abc import Mapping
from collections.abc import Sequence
from statistics import median

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue

# Messages in and out, not used, of these too late, and dropped by the middleware.
ALWAYS = ('in', 'out', 'refused', 'late', 'lost')
# Of each input, so many times are kept.
_TIMED = 1000


class Health:
    """
    The state of a node for ``/diagnostics``.

    ``counts`` are those of all its life, ``trouble`` what was last amiss since the last status.
    """

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter(dict.fromkeys(ALWAYS, 0))
        self.trouble = ''
        self._spent_ms: dict[str, deque[float]] = defaultdict(lambda: deque(maxlen=_TIMED))

    def spent(self, topic: str, seconds: float) -> None:
        """Take the time that a message of a topic took [s]."""
        self._spent_ms[topic].append(1e3 * seconds)

    def status(
        self, name: str, faults: Sequence[str], facts: Mapping[str, str],
    ) -> DiagnosticStatus:
        """
        Return the status of a node, and forget its trouble.

        Parameters
        ----------
        name
            Full name of the node.
        faults
            What is wrong now and lasts: the status is then ERROR.  It is WARN where anything was
            refused, late or lost since the last one.
        facts
            What else to say, by key.

        """
        values = {key: str(count) for key, count in sorted(self.counts.items())}
        for topic, spent in self._spent_ms.items():
            values[f'{topic} median [ms]'] = f'{median(spent):.3f}'
            values[f'{topic} longest [ms]'] = f'{max(spent):.3f}'
        level = DiagnosticStatus.WARN if self.trouble else DiagnosticStatus.OK
        said = [*faults, self.trouble] if self.trouble else [*faults]
        self.trouble = ''
        return DiagnosticStatus(
            level=DiagnosticStatus.ERROR if faults else level, name=name,
            message='; '.join(said),
            values=[KeyValue(key=key, value=value) for key, value in {**values, **facts}.items()])
