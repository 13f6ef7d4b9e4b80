"""Replaying a bag: its frames, each with its truth."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from collections.abc import Iterator
from dataclasses import dataclass
from dataclasses import field
from heapq import merge
import struct

from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.reader import Message

# The longest that a frame waits for truth that was recorded after it [frames].
_WINDOW = 16


@dataclass
class PlayedFrame:
    """A frame and its truth, serialized; ``truth`` is None where the bag has none for it."""

    stamp_ns: int
    image: bytes = b''
    truth: Message | None = None
    odometry: list[bytes] = field(default_factory=list)


def header_stamp(data: bytes) -> int:
    """Return the stamp [ns] of a serialized message that starts with a header."""
    order = '<' if data[1] & 1 else '>'
    seconds, nanoseconds = struct.unpack_from(f'{order}iI', data, 4)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def played_frames(
    bag: Bag, frames_topic: str, truth_topic: str, left_out: Collection[int] = (),
    truth_bag: Bag | None = None,
) -> Iterator[PlayedFrame]:
    """
    Yield the frames of a bag in their order, each with the truth of the same stamp.

    Parameters
    ----------
    bag
        The bag, open.
    frames_topic, truth_topic
        Their names in the bag; an empty ``truth_topic`` leaves out the truth.
    left_out
        Indices of the frames that are left out.
    truth_bag
        The bag that has the truth, if that is another one.

    """
    odometry = f'{truth_topic}/odometry' if truth_topic else ''
    found: dict[int, PlayedFrame] = {}
    order: deque[int] = deque()
    source, number, out = truth_bag or bag, -1, frozenset(left_out)
    for message in _messages(bag, frames_topic, truth_topic, odometry, truth_bag):
        if message.topic == frames_topic:
            number += 1
            if number in out:
                continue
        stamp_ns = header_stamp(message.data)
        frame = found.setdefault(stamp_ns, PlayedFrame(stamp_ns))
        if message.topic == frames_topic:
            frame.image = message.data
            order.append(stamp_ns)
        elif message.topic == truth_topic:
            frame.truth = message
        else:
            frame.odometry.append(message.data)
        while order and (len(order) > _WINDOW or _is_whole(found[order[0]], source, odometry)):
            yield found.pop(order.popleft())
    while order:
        yield found.pop(order.popleft())


def _messages(
    bag: Bag, frames_topic: str, truth_topic: str, odometry: str, truth_bag: Bag | None,
) -> Iterator[Message]:
    """Yield the messages of frames and truth; those of two bags in the order of their stamps."""
    if truth_bag is None:
        return bag.messages({frames_topic, truth_topic, odometry})
    return merge(
        truth_bag.messages({truth_topic, odometry}), bag.messages({frames_topic}),
        key=lambda message: header_stamp(message.data))


def _is_whole(frame: PlayedFrame, bag: Bag, odometry: str) -> bool:
    """Whether the frame has its truth, and one odometry for each object of the truth."""
    if not odometry:
        return True
    if frame.truth is None:
        return False
    objects = sum(bool(item.id) for item in bag.read(frame.truth).detections)
    return odometry not in bag.topics or len(frame.odometry) >= objects
