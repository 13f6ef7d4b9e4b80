"""What a run on a camera says of it while it goes on: that nothing comes, and that it does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import field
import re
import time

from diagnostic_msgs.msg import DiagnosticStatus
from lowsnr_bringup.ros.respawner import tell

_NUMBERS = re.compile(r'[0-9.]+')
# A status says one trouble after the other, each of which begins with its topic.
_NEXT = re.compile(r'; (?=/|image_raw: )')
# A trouble that did not show for so long is a new one.
_NEW_AFTER_S = 60.0


@dataclass
class CameraWatch:
    """
    Says each trouble of the node that hears the camera once, and when frames come again.

    While a trouble lasts its numbers change; without them it is the same.
    """

    clock: Callable[[], float] = time.monotonic
    _seen_s: dict[str, float] = field(default_factory=dict)
    _gone: bool = False

    def look(self, status: DiagnosticStatus) -> None:
        """Take the node's newest status."""
        now_s, gone = self.clock(), status.level == DiagnosticStatus.ERROR
        if self._gone and not gone:
            tell('frames come again')
            self._seen_s.clear()
        self._gone = gone
        for trouble in filter(None, _NEXT.split(status.message)):
            kind = _NUMBERS.sub('', trouble)
            if now_s - self._seen_s.get(kind, -_NEW_AFTER_S) >= _NEW_AFTER_S:
                tell(trouble)
            self._seen_s[kind] = now_s
