# SPDX-License-Identifier: Apache-2.0
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

CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
# The longest that a frame waits for what was recorded after it [frames].
_WINDOW = 16


@dataclass
class PlayedFrame:
    """
    A frame and what goes with it, serialized.

    ``truth`` is None, and ``camera_info`` empty, where the bag has none of its stamp.
    """

    stamp_ns: int
    image: bytes = b''
    camera_info: bytes = b''
    truth: Message | None = None
    odometry: list[bytes] = field(default_factory=list)


def header_stamp(data: bytes) -> int:
    """Return the stamp [ns] of a serialized message that starts with a header."""
    order = '<' if data[1] & 1 else '>'
    seconds, nanoseconds = struct.unpack_from(f'{order}iI', data, 4)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def camera_info_of(bag: Bag, frames_topic: str) -> str:
    """Return the topic that has the ``CameraInfo`` of a bag's frames, beside them; or nothing."""
    beside = frames_topic.removesuffix('/compressed').rpartition('/')[0] + '/camera_info'
    return beside if bag.topics.get(beside) == CAMERA_INFO else ''


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
    info = camera_info_of(bag, frames_topic)
    found: dict[int, PlayedFrame] = {}
    order: deque[int] = deque()
    source, number, out = truth_bag or bag, -1, frozenset(left_out)
    for message in _messages(bag, {frames_topic, info}, truth_topic, truth_bag):
        if message.topic == frames_topic:
            number += 1
            if number in out:
                continue
        stamp_ns = header_stamp(message.data)
        frame = found.setdefault(stamp_ns, PlayedFrame(stamp_ns))
        if message.topic == frames_topic:
            frame.image = message.data
            order.append(stamp_ns)
        elif message.topic == info:
            frame.camera_info = message.data
        elif message.topic == truth_topic:
            frame.truth = message
        else:
            frame.odometry.append(message.data)
        while order and (len(order) > _WINDOW or (
                bool(info) <= bool(found[order[0]].camera_info)
                and _is_whole(found[order[0]], source, odometry))):
            yield _next(found, order)
    while order:
        yield _next(found, order)


def _next(found: dict[int, PlayedFrame], order: deque[int]) -> PlayedFrame:
    """Remove and return the first frame, and forget what came for no frame before it."""
    first = order.popleft()
    waiting = set(order)
    for stamp_ns in [each for each in found if each < first and each not in waiting]:
        del found[stamp_ns]
    return found.pop(first)


def _messages(
    bag: Bag, frames: set[str], truth_topic: str, truth_bag: Bag | None,
) -> Iterator[Message]:
    """Yield the messages of frames and truth; those of two bags in the order of their stamps."""
    truth = {truth_topic, f'{truth_topic}/odometry'} if truth_topic else set()
    if truth_bag is None:
        return bag.messages(frames | truth)
    return merge(
        truth_bag.messages(truth), bag.messages(frames),
        key=lambda message: header_stamp(message.data))


def _is_whole(frame: PlayedFrame, bag: Bag, odometry: str) -> bool:
    """Whether the frame has its truth, and one odometry for each object of the truth."""
    if not odometry:
        return True
    if frame.truth is None:
        return False
    objects = sum(bool(item.id) for item in bag.read(frame.truth).detections)
    return odometry not in bag.topics or len(frame.odometry) >= objects
