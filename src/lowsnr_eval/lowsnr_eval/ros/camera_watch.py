"""What a run on a camera says of it while it goes on: that nothing comes, and that it does."""

from __future__ import annotations

from dataclasses import dataclass
import re

from diagnostic_msgs.msg import DiagnosticStatus
from lowsnr_eval.ros.respawner import tell

_NUMBERS = re.compile(r'[0-9.]+')


@dataclass
class CameraWatch:
    """
    Says each trouble of the node that hears the camera once, and when frames come again.

    ``told`` is the last trouble without its numbers, which change while it lasts.
    """

    told: str = ''
    _gone: bool = False

    def look(self, status: DiagnosticStatus) -> None:
        """Take the node's newest status."""
        kind = _NUMBERS.sub('', status.message)
        if kind and kind != self.told:
            tell(status.message)
            self.told, self._gone = kind, status.level == DiagnosticStatus.ERROR
        elif self._gone and not kind:
            tell('frames come again')
            self.told, self._gone = '', False
