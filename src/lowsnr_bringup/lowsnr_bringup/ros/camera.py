# SPDX-License-Identifier: Apache-2.0
"""The first frames of a camera, from which a run is planned as it is from a bag."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
from tempfile import TemporaryDirectory
import time
from typing import Any

from lowsnr_bringup.plan.recorded_frames import RecordedRun
from lowsnr_bringup.ros.bringup_node import bringup_node
from lowsnr_bringup.run.middleware import middleware_environment
from lowsnr_common.core.records import Malformed
from lowsnr_common.core.timeline import in_seconds
from lowsnr_common.images.image_encodings import is_whole
from lowsnr_common.images.image_encodings import numbers_of
from lowsnr_common.ros.connections import input_faults
from lowsnr_common.ros.connections import name_of
from lowsnr_common.ros.connections import OTHER_TYPE
from lowsnr_common.ros.connections import type_name
from lowsnr_common.ros.images import image_to_array
from lowsnr_common.ros.images import unpacked
from lowsnr_common.ros.messages import stamp_key
from lowsnr_common.ros.qos import any_reliability
from lowsnr_common.settings.text import printable
import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import CompressedImage
from sensor_msgs.msg import Image

_FRAMES = 5
_IMAGE = type_name(Image)


class CameraError(ValueError):
    """
    A camera gives no frames that detectors can use.

    Parameters
    ----------
    reason
        'nobody publishes', 'too few frames', 'changing size', 'constant stamps', or the reason
        of a fault or of a malformed frame.
    text
        One line for the user, which names the topic and what helps.

    """

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(printable(text))
        self.reason = reason


def inspect_camera(topic: str, within_s: float = 10.0) -> RecordedRun:
    """
    Take the first few frames of a camera.

    Parameters
    ----------
    topic
        Full name of its topic.
    within_s
        Longest wait for them [s]; after it two are enough.

    Raises
    ------
    CameraError
        If there are no frames that can be used; one line.

    """
    until = time.monotonic() + within_s
    only_here = os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE') == 'LOCALHOST'
    with _node() as node:
        kind = _wait_for_publisher(node, topic, until, only_here)
        images: list[Any] = []
        subscription = node.create_subscription(
            kind, topic, images.append, any_reliability(_FRAMES))
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)
        while len(images) < _FRAMES and time.monotonic() < until:
            executor.spin_once(timeout_sec=0.05)
        executor.shutdown()
        if len(images) < 2:
            who = ', '.join(map(name_of, node.get_publishers_info_by_topic(topic)[:1]))
            if faults := input_faults(node, subscription):
                raise CameraError(faults[0].reason, '; '.join(map(str, faults)))
            raise CameraError(
                'too few frames', f'{topic}: {len(images)} of 2 frames came within {within_s:g} s '
                f'from {who or "a camera that is gone now"}: check that it takes frames, or raise '
                '--camera-within')
    return _described(topic, images)


@contextmanager
def _node() -> Iterator[Node]:
    """Yield bring-up's node, with the middleware set up as for a run."""
    with TemporaryDirectory() as folder:
        added = middleware_environment(
            os.environ, Path(folder), rclpy.get_rmw_implementation_identifier())
        before = {name: os.environ.get(name) for name in added}
        os.environ |= added
        try:
            with bringup_node() as node:
                yield node
        finally:
            for name, value in before.items():  # a run writes a profile of its own
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value


def _wait_for_publisher(node: Node, topic: str, until: float, only_here: bool) -> type:
    """Wait for images on a topic, return their type; CameraError names topics that have some."""
    while not (found := node.get_publishers_info_by_topic(topic)):
        if time.monotonic() > until:
            raise CameraError(
                'nobody publishes', f'{topic}: nobody publishes it{_elsewhere(node, only_here)}')
        time.sleep(0.02)
    kinds = sorted({item.topic_type for item in found})
    kind: type
    for kind in (Image, CompressedImage):
        if type_name(kind) in kinds:
            return kind
    raise CameraError(
        OTHER_TYPE, f'{topic}: has the type {", ".join(kinds)}, not {_IMAGE}'
        f'{_elsewhere(node, only_here)}')


def _elsewhere(node: Node, only_here: bool) -> str:
    """Return what else --camera can be, or where to look for the camera."""
    topics = sorted(
        name for name, kinds in node.get_topic_names_and_types()
        if _IMAGE in kinds and node.count_publishers(name))
    if topics:
        return f'; --camera can be {", ".join(topics)}'
    return (f', and there is no topic of type {_IMAGE}: start the camera, on ROS domain '
            f'{node.context.get_domain_id()}'
            + ', or set ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET if it is on another host'
            * only_here)


def _described(topic: str, images: list[Any]) -> RecordedRun:
    """Return what frames have in common; CameraError if detectors cannot use them."""
    compressed = isinstance(images[0], CompressedImage)
    try:
        images = [unpacked(image) if compressed else image for image in images]
        shapes = {image_to_array(image).shape for image in images}
    except Malformed as error:
        raise CameraError(error.reason, f'{topic}: {error}') from None
    if len(shapes) > 1:
        sizes = ' and '.join(f'{cols} x {rows}' for rows, cols in sorted(shapes))
        raise CameraError(
            'changing size', f'{topic}: its frames have {sizes} pixels, and must have one size')
    stamps_ns = [stamp_key(image.header.stamp) for image in images]
    period_s = float(np.median(np.diff(stamps_ns))) / 1e9
    if period_s <= 0.0:
        raise CameraError(
            'constant stamps', f'{topic}: the stamps of its frames do not grow '
            f'({", ".join(in_seconds(stamp) for stamp in stamps_ns)} s): set up the camera '
            'to stamp each frame')
    rows, cols = shapes.pop()
    blank = any(not is_whole(numbers_of(image)) for image in images)
    return RecordedRun(
        name=topic.strip('/'), frames=0, rows=rows, cols=cols, period_s=period_s, truth=False,
        raw=True, encoding=images[-1].encoding, compressed=compressed,
        blank='one of its first frames' * blank)
