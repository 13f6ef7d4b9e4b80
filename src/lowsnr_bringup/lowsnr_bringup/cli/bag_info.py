# SPDX-License-Identifier: Apache-2.0
"""What ``ros2 bag info`` prints of a bag."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any
from typing import NamedTuple

from lowsnr_bringup.bags.bag_files import find_files
from lowsnr_bringup.bags.bag_files import INFORMATION
from lowsnr_bringup.bags.bag_files import METADATA_FILE
from lowsnr_bringup.bags.reader import Bag
from lowsnr_common.settings.text import one_line
from lowsnr_common.settings.text import printable
from lowsnr_common.settings.text import read_yaml

_NANO = 1_000_000_000
_UNITS = ('B', 'KiB', 'MiB', 'GiB', 'TiB')
_STORAGES = {'.mcap': 'mcap', '.bag': 'rosbag_v2'}
_COLUMN = 19  # of the values
_LONGEST_NS = 2**63


class TopicCount(NamedTuple):
    """A topic of a bag: name, type, number of messages and form of their bytes."""

    name: str
    msgtype: str
    messages: int
    serialization: str = 'cdr'


@dataclass(frozen=True)
class BagInfo:
    """
    The contents of a bag.

    ``start_ns`` and ``duration_ns`` are those of the times at which messages were recorded [ns],
    ``size`` is that of its files [bytes].
    """

    files: Sequence[Path]
    size: int
    storage: str
    distro: str
    start_ns: int
    duration_ns: int
    topics: Sequence[TopicCount]
    notes: Sequence[str] = ()

    def __str__(self) -> str:
        """Return the lines that are printed."""
        rows = {
            'Files:': _block([printable(path.name) for path in self.files]),
            'Bag size:': _size(self.size),
            'Storage id:': printable(self.storage),
            'ROS Distro:': printable(self.distro),
            'Duration:': f'{_seconds(self.duration_ns)}s',
            'Start:': _time(self.start_ns),
            'End:': _time(self.start_ns + self.duration_ns),
            'Messages:': str(sum(topic.messages for topic in self.topics)),
            'Topic information:': _block([
                f'Topic: {printable(topic.name)} | Type: {printable(topic.msgtype)} | '
                f'Count: {topic.messages} | Serialization Format: {printable(topic.serialization)}'
                for topic in self.topics]),
            'Service:': '0',
            'Service information:': '',
        }
        return '\n' + ''.join(f'{key:{_COLUMN - 1}} {text}\n' for key, text in rows.items())


def bag_info(path: Path) -> BagInfo:
    """
    Return the contents of a bag: those of its metadata, or counted where it has none.

    Raises
    ------
    ValueError
        One line that names the file that cannot be used.

    """
    files = find_files(path)
    size = sum(file.stat().st_size for file in files.paths)
    metadata = path / METADATA_FILE
    if not metadata.is_file():
        return _counted(path, files.paths, size)
    try:
        return _stated(read_yaml(metadata)[INFORMATION], files.paths, size)
    except (LookupError, TypeError, AttributeError, OverflowError) as error:
        raise ValueError(f'{metadata}: is not the metadata of a bag: '
                         f'{type(error).__name__} {one_line(error)}') from None


def _stated(information: Mapping[str, Any], paths: Sequence[Path], size: int) -> BagInfo:
    topics = []
    for item in information['topics_with_message_count']:
        topic = item['topic_metadata']
        topics.append(TopicCount(
            str(topic['name']), str(topic['type']), int(item['message_count']),
            str(topic['serialization_format'])))
    times = (int(information['starting_time']['nanoseconds_since_epoch']),
             int(information['duration']['nanoseconds']))
    if not all(abs(each) < _LONGEST_NS for each in times):
        raise OverflowError('a time is out of range')
    return BagInfo(
        paths, size, str(information['storage_identifier']),
        str(information.get('ros_distro') or 'unknown'), *times, topics)


def _counted(path: Path, paths: Sequence[Path], size: int) -> BagInfo:
    """Return the contents of a bag without metadata by reading all its messages."""
    counts: Counter[str] = Counter()
    first, last = _LONGEST_NS, 0
    with Bag(path) as bag:
        for message in bag.messages(bag.topics):
            counts[message.topic] += 1
            first, last = min(first, message.logged_ns), max(last, message.logged_ns)
        topics = [TopicCount(name, kind, counts[name]) for name, kind in bag.topics.items()]
        notes = list(bag.notes)
    if not counts:
        first = last
    storage = next((name for end, name in _STORAGES.items() if end in paths[0].name), 'sqlite3')
    return BagInfo(paths, size, storage, 'unknown', first, last - first, topics, notes)


def _block(lines: Sequence[str]) -> str:
    return ('\n' + _COLUMN * ' ').join(lines)


def _size(count: float) -> str:
    for unit in _UNITS:
        if count < 1024 or unit == _UNITS[-1]:
            break
        count /= 1024
    return f'{count:.0f} B' if unit == 'B' else f'{count:.1f} {unit}'


def _seconds(time_ns: int) -> str:
    return f'{time_ns // _NANO}.{time_ns % _NANO:09d}'


def _time(time_ns: int) -> str:
    """Return a time as date, time of day and seconds since 1970, all nanoseconds of it."""
    when = datetime.fromtimestamp(time_ns // _NANO)
    return (f'{when:%b} {when.day:2d} {when:%Y %H:%M:%S}.{time_ns % _NANO:09d} '
            f'({_seconds(time_ns)})')
