# SPDX-License-Identifier: Apache-2.0
"""A bare round trip of an image between two processes: the reference for times of the graph."""

import argparse
from collections.abc import Callable
import multiprocessing
from pathlib import Path
import statistics
import sys
import time
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / 'scripts'), str(ROOT / 'test' / 'support')]

import _environment  # noqa: E402

# For the other process to be found, and for an image to come back [s].
WITHIN_S = 60.0


def main() -> int:
    """Print the median and the 99 % quantile of the round trip."""
    parser = argparse.ArgumentParser(
        description=__doc__, allow_abbrev=False,
        epilog='example: python benchmarks/round_trip.py --side 1024')
    parser.add_argument('--side', type=int, default=20, help='rows and columns (20)')
    parser.add_argument('--count', type=int, default=200, help='round trips (200)')
    options = parser.parse_args()
    _environment.ensure()
    from graph_runs import enter_own_domain
    enter_own_domain()
    times = round_trips(options.side, options.count)
    print(f'{options.side} x {options.side}: median {1e3 * statistics.median(times):.3f} ms, '
          f'99 % {1e3 * statistics.quantiles(times, n=100)[-1]:.3f} ms')
    return 0


def round_trips(side: int, count: int) -> list[float]:
    """
    Return the time of each round trip of a float32 image [s], after the first few.

    Raises TimeoutError where the other process is not found, or sends no image back.
    """
    other = multiprocessing.get_context('spawn').Process(target=echo, daemon=True)
    other.start()
    try:
        return _measure(side, count)
    finally:
        other.kill()
        other.join()


def _measure(side: int, count: int) -> list[float]:
    from lowsnr_common.ros.messages import frame_to_image
    import numpy as np
    import rclpy
    from sensor_msgs.msg import Image
    from std_msgs.msg import Header

    rclpy.init()
    node = rclpy.create_node('there')
    try:
        answers: list[Image] = []
        node.create_subscription(Image, 'back', answers.append, 10)
        publisher = node.create_publisher(Image, 'there', 10)
        _spin_until(node, lambda: publisher.get_subscription_count()
                    and node.count_publishers('back'), 'the other process was not found')
        time.sleep(0.5)
        image = frame_to_image(np.zeros((side, side)), Header())
        times = []
        for _ in range(count + 5):
            answers.clear()
            start = time.perf_counter()
            publisher.publish(image)
            _spin_until(node, lambda: answers, 'no image came back')
            times.append(time.perf_counter() - start)
        return times[5:]
    finally:
        node.destroy_node()
        rclpy.shutdown()


def _spin_until(node: Any, condition: Callable[[], Any], failure: str) -> None:
    import rclpy

    until = time.monotonic() + WITHIN_S
    while not condition():
        rclpy.spin_once(node, timeout_sec=0.1)
        if time.monotonic() > until:
            raise TimeoutError(f'{failure} within {WITHIN_S:g} s')


def echo() -> None:
    """Send every image back, until killed."""
    import rclpy
    from sensor_msgs.msg import Image

    rclpy.init()
    node = rclpy.create_node('echo')
    publisher = node.create_publisher(Image, 'back', 10)
    node.create_subscription(Image, 'there', publisher.publish, 10)
    rclpy.spin(node)


if __name__ == '__main__':
    sys.exit(main())
