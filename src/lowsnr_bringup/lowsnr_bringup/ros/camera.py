"""A camera looked at before a run begins, so that the run can be planned as for a bag."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
from tempfile import TemporaryDirectory
import time

from lowsnr_bringup.bags.recorded_run import RecordedRun
from lowsnr_bringup.plan.graph import MANAGER
from lowsnr_bringup.run.middleware import middleware_environment
from lowsnr_common.ros.connections import input_faults
from lowsnr_common.ros.connections import name_of
from lowsnr_common.ros.connections import type_name
from lowsnr_common.ros.images import image_to_array
from lowsnr_common.ros.messages import stamp_key
from lowsnr_common.ros.qos import any_reliability
import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image

_FRAMES = 5
_IMAGE = type_name(Image)


def look_at_camera(topic: str, within_s: float = 10.0) -> RecordedRun:
    """
    Take the first few frames of a camera.

    Parameters
    ----------
    topic
        Full name of its topic.
    within_s
        Longest wait for them [s]; two will do then.

    Raises
    ------
    ValueError
        One line that names the topic, why there are no frames to be used, and the mend.

    """
    until = time.monotonic() + within_s
    with _node() as node:
        _wait_for_publisher(node, topic, until)
        images: list[Image] = []
        subscription = node.create_subscription(
            Image, topic, images.append, any_reliability(_FRAMES))
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)
        while len(images) < _FRAMES and time.monotonic() < until:
            executor.spin_once(timeout_sec=0.05)
        executor.shutdown()
        if len(images) < 2:
            who = ', '.join(map(name_of, node.get_publishers_info_by_topic(topic)[:1]))
            why = '; '.join(input_faults(node, subscription)) or (
                f'{topic}: {len(images)} of 2 frames came within {within_s:g} s from '
                f'{who or "a camera that has gone"}: see that it takes frames, or raise '
                '--camera-within')
            raise ValueError(why)
    return _described(topic, images)


@contextmanager
def _node() -> Iterator[Node]:
    """Yield a node in a context of its own, for whose sockets holds what holds for a run's."""
    with TemporaryDirectory() as folder:
        added = middleware_environment(
            os.environ, Path(folder), rclpy.get_rmw_implementation_identifier())
        before = {name: os.environ.get(name) for name in added}
        os.environ |= added
        context = rclpy.Context()
        rclpy.init(
            args=['--ros-args', '--enclave', f'/{MANAGER}'], context=context,
            signal_handler_options=SignalHandlerOptions.NO)
        node = Node(MANAGER, context=context, use_global_arguments=False)
        try:
            yield node
        finally:
            node.destroy_node()
            context.try_shutdown()
            for name, value in before.items():  # a run writes a profile of its own
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value


def _wait_for_publisher(node: Node, topic: str, until: float) -> None:
    """Wait until somebody publishes images on a topic, or say who does on which."""
    while not (found := node.get_publishers_info_by_topic(topic)):
        if time.monotonic() > until:
            raise ValueError(f'{topic}: nobody publishes it{_elsewhere(node)}')
        time.sleep(0.02)
    kinds = sorted({item.topic_type for item in found})
    if _IMAGE not in kinds:
        raise ValueError(f'{topic}: is of type {", ".join(kinds)}, not {_IMAGE}{_elsewhere(node)}')


def _elsewhere(node: Node) -> str:
    """Say what else --camera can be, or where to look for the camera."""
    topics = sorted(
        name for name, kinds in node.get_topic_names_and_types()
        if _IMAGE in kinds and node.count_publishers(name))
    if topics:
        return f'; --camera can be {", ".join(topics)}'
    range_ = os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE')
    return (f', and there is no topic of type {_IMAGE}: start the camera, on ROS domain '
            f'{node.context.get_domain_id()}'
            + ', or set ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET where it is on another host'
            * (range_ == 'LOCALHOST'))


def _described(topic: str, images: list[Image]) -> RecordedRun:
    """Return what frames show; ValueError where detectors can make nothing of them."""
    try:
        shapes = {image_to_array(image).shape for image in images}
    except ValueError as error:
        raise ValueError(f'{topic}: {error}') from None
    if len(shapes) > 1:
        sizes = ' and '.join(f'{cols} x {rows}' for rows, cols in sorted(shapes))
        raise ValueError(f'{topic}: its frames are of {sizes} pixels, and must be of one size')
    stamps_ns = [stamp_key(image.header.stamp) for image in images]
    period_s = float(np.median(np.diff(stamps_ns))) / 1e9
    if period_s <= 0.0:
        raise ValueError(
            f'{topic}: the stamps of its frames do not grow '
            f'({", ".join(f"{stamp / 1e9:.14g}" for stamp in stamps_ns)} s): have the camera '
            'stamp each frame')
    rows, cols = shapes.pop()
    return RecordedRun(
        name=topic.strip('/'), frames=0, rows=rows, cols=cols, period_s=period_s, truth=False,
        raw=True, encoding=images[-1].encoding)
