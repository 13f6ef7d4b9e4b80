# SPDX-License-Identifier: Apache-2.0
"""Recording a run: the counts of the recorder, and a summary of its bags."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import itertools
import json
from pathlib import Path

from lowsnr_bringup.bags.bag_files import INFORMATION
from lowsnr_bringup.bags.bag_files import METADATA_FILE
from lowsnr_common.settings.text import printable
from lowsnr_common.settings.text import read_yaml

# Names of the texts that the metadata of a recorded bag carry.
CUSTOM_PARAMETERS = 'lowsnr_parameters'
CUSTOM_LOSSES = 'lowsnr_losses'


@dataclass
class Tally:
    """
    Counts of the messages of one topic.

    A publisher numbers its messages from 1, so that a lost message leaves a gap in the numbers.
    The numbers of several publishers are mixed: there the count of the middleware is used.

    Attributes
    ----------
    received
        Messages received.
    reported
        Messages that the middleware reported as lost.
    shared
        Whether the topic has several publishers.
    last
        Number of the last message, 0 before the first one.  None if the publisher may have
        started before the recorder: its first number then means nothing.

    """

    received: int = 0
    reported: int = 0
    shared: bool = False
    last: int | None = None
    _gaps: int = 0

    @property
    def lost(self) -> int:
        """Return the number of messages that were published and not received."""
        return self.reported if self.shared else self._gaps

    def add(self, number: int) -> None:
        """Count a message by its publisher's number."""
        self.received += 1
        if self.last is not None:
            # The number is smaller where the publisher was restarted.
            self._gaps += max(0, number - self.last - 1)
        self.last = number


@dataclass(frozen=True)
class RecordingSummary:
    """
    What a recorder left in a folder.

    Attributes
    ----------
    folder
        The folder of the bag.
    exists
        Whether anything is there.
    finished
        Whether the recorder closed the bag; the counts are 0 otherwise.
    messages, topics
        Their numbers.
    losses
        Lost messages by topic, only topics that lost some.

    """

    folder: Path
    exists: bool = True
    finished: bool = False
    messages: int = 0
    topics: int = 0
    losses: Mapping[str, int] | None = None

    def __str__(self) -> str:
        if not self.exists:
            return f'nothing was recorded in {self.folder}'
        if not self.finished:
            return f'recording ended early; the bag in {self.folder} is good up to there'
        losses = self.losses or {}
        each = ', '.join(f'{count} on {printable(name)}' for name, count in losses.items())
        return (f'recorded {self.messages} messages on {self.topics} topics in {self.folder}, '
                f'{sum(losses.values())} lost' + (f': {each}' if each else ''))


def summarize_recording(folder: Path) -> RecordingSummary:
    """Return what a recorder left in a folder."""
    if not (folder.is_dir() and any(folder.iterdir())):
        return RecordingSummary(folder, exists=False)
    try:
        information = read_yaml(folder / METADATA_FILE)[INFORMATION]
        losses = json.loads(information['custom_data'][CUSTOM_LOSSES])
        return RecordingSummary(
            folder, finished=True, messages=information['message_count'],
            topics=len(information['topics_with_message_count']), losses=dict(losses))
    except (LookupError, TypeError, ValueError, RecursionError):
        # The disk was full when they were to be written, or the bag was changed since.
        return RecordingSummary(folder)


def restarted_bag(bag: Path, restarts: int) -> Path:
    """Return the bag of a recorder after some restarts: each start writes its own."""
    return bag.with_name(f'{bag.name}-{restarts + 1}') if restarts else bag


def bags_of_run(bag: Path) -> list[Path]:
    """Return the bags of a run: one, and one more for each restart of its recorder."""
    more = (restarted_bag(bag, restarts) for restarts in itertools.count(1))
    return [bag, *itertools.takewhile(Path.exists, more)]
