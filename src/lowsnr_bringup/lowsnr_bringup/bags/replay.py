"""Replaying a bag: its frames, each with its truth."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from dataclasses import field
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


def played_frames(bag: Bag, frames_topic: str, truth_topic: str) -> Iterator[PlayedFrame]:
    """
    Yield the frames of a bag in their order, each with the truth of the same stamp.

    Parameters
    ----------
    bag
        The bag, open.
    frames_topic, truth_topic
        Their names in the bag; an empty ``truth_topic`` leaves out the truth.

    """
    odometry = f'{truth_topic}/odometry' if truth_topic else ''
    found: dict[int, PlayedFrame] = {}
    order: deque[int] = deque()
    for message in bag.messages({frames_topic, truth_topic, odometry}):
        stamp_ns = header_stamp(message.data)
        frame = found.setdefault(stamp_ns, PlayedFrame(stamp_ns))
        if message.topic == frames_topic:
            frame.image = message.data
            order.append(stamp_ns)
        elif message.topic == truth_topic:
            frame.truth = message
        else:
            frame.odometry.append(message.data)
        while order and (len(order) > _WINDOW or _is_whole(found[order[0]], bag, odometry)):
            yield found.pop(order.popleft())
    while order:
        yield found.pop(order.popleft())


def _is_whole(frame: PlayedFrame, bag: Bag, odometry: str) -> bool:
    """Whether the frame has its truth, and one odometry for each object of the truth."""
    if not odometry:
        return True
    if frame.truth is None:
        return False
    objects = sum(bool(item.id) for item in bag.read(frame.truth).detections)
    return odometry not in bag.topics or len(frame.odometry) >= objects
