"""When a node that died is started again, and when it is given up."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from dataclasses import field


@dataclass(frozen=True)
class RespawnPolicy:
    """
    At once the first time, later each time after twice the wait; not without end.

    ``most`` deaths within ``window_s`` are made good, the first of them at once, the second
    after ``wait_s``.
    """

    most: int = 5
    window_s: float = 60.0
    wait_s: float = 0.5


@dataclass
class Deaths:
    """The deaths of one node."""

    policy: RespawnPolicy
    count: int = 0
    _recent: deque[float] = field(default_factory=deque)

    def add(self, now_s: float) -> float | None:
        """Count a death; return how long to wait [s], or None where the node is given up."""
        self.count += 1
        while self._recent and now_s - self._recent[0] > self.policy.window_s:
            self._recent.popleft()
        self._recent.append(now_s)
        recent = len(self._recent)
        if recent > self.policy.most:
            return None
        return 0.0 if recent == 1 else self.policy.wait_s * 2.0 ** (recent - 2)
