# SPDX-License-Identifier: Apache-2.0
"""The frames of a topic of a bag: read through, checked, and those in order picked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.formats.pixels import check_steps
from lowsnr_common.core.records import Malformed
from lowsnr_common.core.timeline import in_seconds
from lowsnr_common.core.timeline import increasing
from lowsnr_common.images.compressed import decode_compressed
from lowsnr_common.images.image_encodings import check_image
from lowsnr_common.images.image_encodings import is_whole
from lowsnr_common.images.image_encodings import numbers_of
from lowsnr_common.images.image_encodings import pixels_of
import numpy as np
from numpy.typing import NDArray

IMAGE, COMPRESSED = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage'
_FINE = ('32SC1', '64FC1')  # finer than the 32-bit floating point of the nodes
_MOST_STEPS = 100  # periods from a first stamp 0 to the next: beyond, no clock was set


@dataclass(frozen=True)
class BagFrames:
    """
    The frames of a topic of a bag.

    Attributes
    ----------
    stamps_ns : (T,) ndarray
        Their stamps, in the order of the bag [ns].
    kept : (K,) ndarray
        Indices of the frames that are replayed, whose stamps increase.
    shape
        Rows and columns of every frame.
    encoding
        How they are encoded; of compressed ones as what they are unpacked to.
    blank
        The first frame with a pixel that is not a finite number up to 1e9; empty if none has.

    """

    stamps_ns: NDArray[np.int64]
    kept: NDArray[np.int64]
    shape: tuple[int, int]
    encoding: str
    blank: str

    def note(self, topic: str) -> str:
        """Return how many frames are left out and which is the first; nothing if none is."""
        out = np.setdiff1d(np.arange(len(self.stamps_ns)), self.kept)
        if not out.size:
            return ''
        return (f'{topic}: {out.size} of {len(self.stamps_ns)} frames are left out, because their '
                'stamps are zero, repeated or not after those before them; the first is frame '
                f'{out[0] + 1}, of {in_seconds(int(self.stamps_ns[out[0]]))} s')


def check_type(bag: Bag, topic: str, msgtypes: tuple[str, ...], option: str) -> None:
    """
    Check that a bag has a topic of one of some types.

    Raises
    ------
    UnusableFile
        With reason ``type`` or ``no topic``; the line names the topics of that type, and the
        option that picks one.

    """
    alike = sorted(name for name, kind in bag.topics.items() if kind in msgtypes)
    if topic in bag.topics and topic not in alike:
        raise UnusableFile(
            bag.path, 'type', f'{topic} is of type {bag.topics[topic]}, not {msgtypes[0]}')
    if topic not in bag.topics:
        hint = f'; {option} can be {", ".join(alike)}' if alike else ''
        raise UnusableFile(
            bag.path, 'no topic', f'has no topic {topic} of type {msgtypes[0]}{hint}')


def read_frames(bag: Bag, topic: str) -> BagFrames:
    """Read all frames; UnusableFile names the first that detectors cannot use."""
    stamps_ns: list[int] = []
    shape, encoding, blank = (0, 0), '', ''
    for message in bag.messages({topic}):
        image = bag.read(message)
        where = f'{topic}: frame {len(stamps_ns) + 1}'
        try:
            found, encoding = _checked(image)
        except Malformed as error:
            raise UnusableFile(bag.path, error.reason, f'{where}: {error}') from None
        if not stamps_ns and encoding in _FINE:
            check_steps(numbers_of(image), pixels_of(image), bag.path, f'{where}: ')
        shape = shape if stamps_ns else found
        if found != shape:
            raise UnusableFile(
                bag.path, 'size', f'{where} has {found[1]} x {found[0]} pixels after frames of '
                f'{shape[1]} x {shape[0]}')
        if not blank and encoding == '32FC1' and not is_whole(pixels_of(image)):
            blank = f'frame {len(stamps_ns) + 1}'
        stamp = image.header.stamp
        stamps_ns.append(stamp.sec * 1_000_000_000 + stamp.nanosec)
    if not stamps_ns:
        because = f' ({"; ".join(bag.notes)})' if bag.notes else ''
        raise UnusableFile(bag.path, 'no frames', f'{topic}: no frames{because}')
    kept = _in_order(stamps_ns)
    if len(kept) < min(2, len(stamps_ns)):
        raise UnusableFile(
            bag.path, 'stamps', f'{topic}: the stamps of its {len(stamps_ns)} frames do not '
            'increase: record it again with a camera that stamps each frame')
    return BagFrames(np.array(stamps_ns), np.array(kept, np.int64), shape, encoding, blank)


def _in_order(stamps_ns: list[int]) -> list[int]:
    """Return the indices of frames that are replayed; a first stamp 0 must be near the next."""
    kept = increasing(stamps_ns)
    if len(kept) > 1 and stamps_ns[kept[0]] == 0:
        steps_ns = np.diff([stamps_ns[k] for k in kept])
        if steps_ns[0] > _MOST_STEPS * np.median(steps_ns):
            return kept[1:]
    return kept


def _checked(image: Any) -> tuple[tuple[int, int], str]:
    """Return rows, columns and encoding of an image; Malformed if detectors cannot use it."""
    if hasattr(image, 'format'):
        pixels = decode_compressed(image)
        return (pixels.shape[0], pixels.shape[1]), f'mono{8 * pixels.itemsize}'
    check_image(image)
    return (image.height, image.width), image.encoding
