"""What a recorder counts, and what it leaves in the bag's metadata."""

from __future__ import annotations

from dataclasses import dataclass
import itertools
import json
from pathlib import Path

from lowsnr_bringup.bags.writer import METADATA_FILE
import yaml

CUSTOM_PARAMETERS = 'lowsnr_parameters'
CUSTOM_LOSSES = 'lowsnr_losses'


@dataclass
class Tally:
    """
    The messages of one topic.

    The only publisher of a topic numbers its messages from 1, so that each one lost shows as a
    gap after the ``last`` that came; it is 0 before the first, and None where the publisher may
    have begun before.  Where several publish, ``reported`` counts those that the middleware says
    it lost.
    """

    received: int = 0
    reported: int = 0
    shared: bool = False
    last: int | None = None
    _gaps: int = 0

    @property
    def lost(self) -> int:
        """Return the number of messages that were sent and did not come."""
        return self.reported if self.shared else self._gaps

    def add(self, number: int) -> None:
        """Count a message by its publisher's number."""
        self.received += 1
        if self.last is not None:
            # A smaller number is that of a publisher that was started again.
            self._gaps += max(0, number - self.last - 1)
        self.last = number


def bag_of_life(bag: Path, lives: int) -> Path:
    """Return the bag of a recorder that was started so often before: each has its own."""
    return bag.with_name(f'{bag.name}-{lives + 1}') if lives else bag


def bags_of(bag: Path) -> list[Path]:
    """Return the bags of a run: one, and one more for each restart of its recorder."""
    found = itertools.takewhile(Path.exists, (bag_of_life(bag, n) for n in itertools.count(1)))
    return [bag, *found]


def describe_bag(folder: Path) -> str:
    """Say in a line what a recorder left in a folder."""
    if not (folder.is_dir() and any(folder.iterdir())):
        return f'nothing was recorded in {folder}'
    try:
        tree = yaml.safe_load((folder / METADATA_FILE).read_text(encoding='utf-8'))
    except OSError:
        tree = None
    # A disk may have been full before there were any, or when they were written.
    information = (tree or {}).get('rosbag2_bagfile_information') or {}
    losses = (information.get('custom_data') or {}).get(CUSTOM_LOSSES)
    if losses is None:
        return f'recording ended early; the bag in {folder} is good up to there'
    lost = json.loads(losses)
    each = ', '.join(f'{count} on {name}' for name, count in lost.items())
    return (f'recorded {information["message_count"]} messages on '
            f'{len(information["topics_with_message_count"])} topics in {folder}, '
            f'{sum(lost.values())} lost' + (f': {each}' if each else ''))
