# SPDX-License-Identifier: Apache-2.0
"""
The bookkeeping of a run as typed records, and back: frames scored, restarts, false-alarm rates.

The topics ``scored`` and ``restarts`` are ``diagnostic_msgs/DiagnosticArray``, whose values are
text that anybody may publish.  This is the one module that writes and reads that text.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping
from dataclasses import asdict
from dataclasses import dataclass
import re

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue
from lowsnr_common.core.records import AlarmRate
from lowsnr_common.core.records import Malformed
from lowsnr_common.ros.messages import stamp_key

SCORED, RESTARTS = 'scored', 'restarts'
ALARM_RATE = 'alarm_rate'  # over the line to bring-up, and between parts of a run
_MOST_CHAINS, _LONGEST_NAME = 1000, 255
_LONGEST_START_S = 3600.0
_NANO = 1_000_000_000
# Fifteen digits are exact as a float and more than any run counts to.
_COUNT, _SECONDS = re.compile('[0-9]{1,15}'), re.compile(r'[0-9]{1,7}(\.[0-9]{1,9})?')
_SHARE = re.compile(r'[01](\.[0-9]{1,9})?')


@dataclass(frozen=True)
class ChainCounts:
    """How many detections and tracks one chain declared in a frame."""

    detector: str
    detections: int
    tracks: int


@dataclass(frozen=True)
class FrameScored:
    """
    The evaluator has scored a frame.

    ``stamp_ns`` is the time of the frame [ns], ``frame`` its number from 1.
    """

    stamp_ns: int
    frame: int
    chains: tuple[ChainCounts, ...]

    def to_message(self) -> DiagnosticArray:
        """Return the record as a message: one status for each chain."""
        message = DiagnosticArray(status=[
            DiagnosticStatus(name=chain.detector, values=pairs(
                frame=self.frame, detections=chain.detections, tracks=chain.tracks))
            for chain in self.chains])
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(self.stamp_ns, _NANO)
        return message

    @classmethod
    def from_message(cls, message: DiagnosticArray) -> FrameScored:
        """
        Return the record that a message holds.

        Raises
        ------
        Malformed
            If the stamp is negative or has too many nanoseconds, there is no chain or more than
            1000, a name is longer than 255 letters or occurs twice, keys are missing, unknown or
            repeated, a value is not a count, or the chains name different frames or frame 0.

        """
        stamp_ns = stamp_of(message)
        if not 0 < len(message.status) <= _MOST_CHAINS:
            raise Malformed('number of chains', f'{len(message.status)} chains, must be 1 to '
                            f'{_MOST_CHAINS}')
        counts = [_counts(status) for status in message.status]
        frames = {frame for frame, _ in counts}
        if len(frames) > 1 or 0 in frames:
            raise Malformed('number of the frame', f'the chains name the frames {sorted(frames)}')
        chains = tuple(chain for _, chain in counts)
        if len({chain.detector for chain in chains}) < len(chains):
            raise Malformed('name of two chains', 'two chains have the same name')
        return cls(stamp_ns, frames.pop(), chains)


@dataclass(frozen=True)
class NodeRestarted:
    """
    A node died and is active again.

    ``node`` is its fully qualified name, ``death`` says how it ended, ``started_s_ago`` is the
    wall time since its new process was started [s].
    """

    node: str
    death: str
    started_s_ago: float

    def to_message(self) -> DiagnosticArray:
        """Return the record as a message of one status."""
        return DiagnosticArray(status=[DiagnosticStatus(
            level=DiagnosticStatus.WARN, name=self.node, message=self.death,
            values=pairs(started_s_ago=f'{self.started_s_ago:.3f}'))])

    @classmethod
    def from_message(cls, message: DiagnosticArray) -> NodeRestarted:
        """
        Return the record that a message holds.

        Raises
        ------
        Malformed
            If it does not describe exactly one node, the name is not a full one of at most 255
            letters, the key is missing, or the time is not one from 0 to 3600 s.

        """
        if len(message.status) != 1:
            raise Malformed('number of nodes', f'{len(message.status)} nodes, must be 1')
        status, = message.status
        name = name_of(status)
        if not name.startswith('/'):
            raise Malformed('not a full name', f'{name!r} is not the full name of a node')
        text = values_of(status, ('started_s_ago',))['started_s_ago']
        if not _SECONDS.fullmatch(text) or float(text) > _LONGEST_START_S:
            raise Malformed('not a time', f'started_s_ago = {text[:40]!r}, must be 0 to '
                            f'{_LONGEST_START_S:g} s')
        return cls(name, status.message, float(text))


def rate_to_message(node: str, rate: AlarmRate) -> DiagnosticArray:
    """Return the false-alarm rate of a detector, by the full name of its node, as a message."""
    shares = {key: '' if share is None else f'{share:.9f}' for key, share in asdict(rate).items()}
    return DiagnosticArray(status=[DiagnosticStatus(name=node, values=pairs(**shares))])


def rate_from_message(message: DiagnosticArray) -> tuple[str, AlarmRate]:
    """
    Return the full name of a node, and the false-alarm rate of its detector.

    Raises
    ------
    Malformed
        If the message does not describe exactly one node, the keys are others, or a value is
        neither empty nor a share.

    """
    if len(message.status) != 1:
        raise Malformed('number of nodes', f'{len(message.status)} nodes, must be 1')
    status, = message.status
    texts = values_of(status, ('asked', 'measured'))
    for key, text in texts.items():
        if text and not (_SHARE.fullmatch(text) and float(text) <= 1.0):
            raise Malformed('not a share', f'{key} = {text[:40]!r} is not from 0 to 1')
    return name_of(status), AlarmRate(
        **{key: float(text) if text else None for key, text in texts.items()})


def stamp_of(message: DiagnosticArray) -> int:
    """Return the stamp of a message [ns]; Malformed if negative or with too many nanoseconds."""
    stamp = message.header.stamp
    if stamp.sec < 0 or stamp.nanosec >= _NANO:
        raise Malformed('not a stamp', f'the stamp is {stamp.sec} s and {stamp.nanosec} ns')
    return stamp_key(stamp)


def pairs(**values: object) -> list[KeyValue]:
    """Return values by key as a status holds them."""
    return [KeyValue(key=key, value=str(value)) for key, value in values.items()]


def _counts(status: DiagnosticStatus) -> tuple[int, ChainCounts]:
    """Return the number of the frame, and what a chain declared in it."""
    texts = values_of(status, ('frame', 'detections', 'tracks'))
    return count_of(texts, 'frame'), ChainCounts(
        name_of(status), count_of(texts, 'detections'), count_of(texts, 'tracks'))


def count_of(texts: Mapping[str, str], key: str) -> int:
    """Return the count that a value states; Malformed if it is none."""
    if not _COUNT.fullmatch(texts[key]):
        raise Malformed('not a count', f'{key} = {texts[key][:40]!r} is not a count')
    return int(texts[key])


def values_of(status: DiagnosticStatus, wanted: Iterable[str]) -> dict[str, str]:
    """Return the values of a status that has these keys, each once, and no other; or Malformed."""
    keys = [item.key for item in status.values]
    if sorted(keys) != sorted(wanted):
        raise Malformed('wrong keys', f'the keys are {[key[:40] for key in keys[:5]]}, must be '
                        f'{list(wanted)}')
    return {item.key: item.value for item in status.values}


def name_of(status: DiagnosticStatus) -> str:
    """Return the name of a status; Malformed if it has more than 255 letters."""
    name = str(status.name)
    if len(name) > _LONGEST_NAME:
        raise Malformed('name too long', f'name {name[:20]!r}... has {len(name)} letters, at '
                        f'most {_LONGEST_NAME}')
    return name
