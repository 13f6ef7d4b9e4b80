# SPDX-License-Identifier: Apache-2.0
"""Writing a bag of frames and truth without a node."""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from builtin_interfaces.msg import Time
from lowsnr_bringup.bags.storage import Topic
from lowsnr_bringup.bags.writer import BagWriter
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Truth
from lowsnr_common.ros import messages
from lowsnr_common.ros.images import array_to_image
import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Header

FRAME_ID = 'sensor'


class FrameBag:
    """
    Writer of a bag of frames and truth, with cells of 1 m; use it in ``with``.

    Parameters
    ----------
    folder
        Folder of the bag; must not exist.
    storage
        ``'mcap'`` or ``'sqlite3'``.
    custom
        Texts by name that the metadata of the bag carry.
    frames_topic
        Topic of the frames.

    Raises
    ------
    UnusableFile
        If the folder exists or cannot be made.

    """

    def __init__(
        self, folder: Path, storage: str = 'mcap', custom: Mapping[str, str] | None = None,
        frames_topic: str = '/image_raw',
    ) -> None:
        self._bag = BagWriter(folder, storage, custom)
        self._frames_topic = frames_topic
        self._topics: dict[str, Topic] = {}

    def __enter__(self) -> FrameBag:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bag.close()

    def add(self, frame: NDArray[np.number], stamp_ns: int, truth: Sequence[Truth] | None) -> None:
        """
        Add a frame.

        Parameters
        ----------
        frame : (rows, cols) ndarray
            Of type ``uint8``, ``uint16`` or floating point.
        stamp_ns
            Its time [ns].
        truth
            Objects present in it; None if they are not known.

        Raises
        ------
        ValueError
            If the frame is of another type.

        """
        header = _header(stamp_ns)
        self._write('/clock', Clock(clock=header.stamp), stamp_ns)
        if truth is not None:
            self.add_truth(stamp_ns, truth)
        self._write(self._frames_topic, array_to_image(frame, header), stamp_ns)

    def add_truth(self, stamp_ns: int, truth: Sequence[Truth]) -> None:
        """Add the objects that are present at a time [ns]."""
        header = _header(stamp_ns)
        objects = [Estimate(item.state, np.zeros((4, 4)), 1.0, item.id) for item in truth]
        for item in objects:
            odometry = messages.estimate_to_odometry(item, header)
            self._write('/ground_truth/odometry', odometry, stamp_ns)
        self._write('/ground_truth', messages.estimates_to_array(objects, header, 1.0), stamp_ns)

    def sync(self) -> None:
        """Make the bag readable up to here, even if the process is killed."""
        self._bag.sync()

    def _write(self, name: str, message: Any, stamp_ns: int) -> None:
        if name not in self._topics:
            kind = type(message)
            package, folder, _ = kind.__module__.split('.')
            self._topics[name] = self._bag.add_topic(name, f'{package}/{folder}/{kind.__name__}')
        self._bag.write(self._topics[name], serialize_message(message), stamp_ns, stamp_ns)


def _header(stamp_ns: int) -> Header:
    return Header(frame_id=FRAME_ID, stamp=Time(
        sec=stamp_ns // 1_000_000_000, nanosec=stamp_ns % 1_000_000_000))
