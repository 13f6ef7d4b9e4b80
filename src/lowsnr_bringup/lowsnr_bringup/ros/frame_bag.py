"""A bag of frames and truth, made without a node."""

from __future__ import annotations

import array
from collections.abc import Mapping
from collections.abc import Sequence
from pathlib import Path
import sys
from types import TracebackType
from typing import Any

from builtin_interfaces.msg import Time
from lowsnr_bringup.bags.writer import BagWriter
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Truth
from lowsnr_common.ros import messages
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.serialization import serialize_message
from rosbags.interfaces import Connection
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray

FRAME_ID = 'sensor'
_INTEGER_ENCODINGS = {'uint8': 'mono8', 'uint16': 'mono16'}
_TYPES = {
    '/clock': Clock, '/image_raw': Image, '/ground_truth': Detection2DArray,
    '/ground_truth/odometry': Odometry}


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
        Texts by name that the bag's metadata shall carry.

    Raises
    ------
    ValueError
        One line, if the folder exists or cannot be made.

    """

    def __init__(
        self, folder: Path, storage: str = 'mcap', custom: Mapping[str, str] | None = None,
    ) -> None:
        self._bag = BagWriter(folder, storage, custom)
        self._topics: dict[str, Connection] = {}

    def __enter__(self) -> FrameBag:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bag.close()

    def add(self, frame: np.ndarray, stamp_ns: int, truth: Sequence[Truth] | None) -> None:
        """
        Add a frame.

        Parameters
        ----------
        frame : (rows, cols) ndarray
            Of 8 or 16 bits without sign, or of floating-point numbers.
        stamp_ns
            Its time [ns].
        truth
            Objects present in it, None where that is not known.

        """
        header = Header(frame_id=FRAME_ID, stamp=Time(
            sec=stamp_ns // 1_000_000_000, nanosec=stamp_ns % 1_000_000_000))
        self._write('/clock', Clock(clock=header.stamp), stamp_ns)
        if truth is not None:
            objects = [Estimate(item.state, np.zeros((4, 4)), 1.0, item.id) for item in truth]
            for item in objects:
                odometry = messages.estimate_to_odometry(item, header)
                self._write('/ground_truth/odometry', odometry, stamp_ns)
            self._write(
                '/ground_truth', messages.estimates_to_array(objects, header, 1.0), stamp_ns)
        self._write('/image_raw', _image(frame, header), stamp_ns)

    def sync(self) -> None:
        """Make the bag whole up to here, whatever comes."""
        self._bag.sync()

    def _write(self, name: str, message: Any, stamp_ns: int) -> None:
        if name not in self._topics:
            package, _, kind = _TYPES[name].__module__.partition('.')
            self._topics[name] = self._bag.add_topic(
                name, f'{package}/{kind.split(".")[0]}/{_TYPES[name].__name__}')
        self._bag.write(self._topics[name], serialize_message(message), stamp_ns, stamp_ns)


def _image(frame: np.ndarray, header: Header) -> Image:
    """Return a frame as an image of its own depth."""
    if np.issubdtype(frame.dtype, np.floating):
        return messages.frame_to_image(frame, header)
    encoding = _INTEGER_ENCODINGS.get(frame.dtype.name)
    if encoding is None:
        raise ValueError(f'frames of {frame.dtype.name} cannot be stored; take uint8, uint16 '
                         'or floating-point numbers')
    data = array.array('B')
    data.frombytes(np.ascontiguousarray(frame).tobytes())
    return Image(
        header=header, height=frame.shape[0], width=frame.shape[1], encoding=encoding,
        is_bigendian=int(sys.byteorder == 'big'), step=frame.itemsize * frame.shape[1], data=data)
