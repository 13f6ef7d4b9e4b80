# SPDX-License-Identifier: Apache-2.0
"""A bare round trip of an image between two processes: the reference for times of the graph."""

import argparse
import multiprocessing
from pathlib import Path
import statistics
import sys
import time

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'scripts'))

import _environment  # noqa: E402


def main() -> int:
    """Print the median and the 99 % quantile of the round trip."""
    parser = argparse.ArgumentParser(
        description=__doc__, allow_abbrev=False,
        epilog='example: python benchmarks/round_trip.py --side 1024')
    parser.add_argument('--side', type=int, default=20, help='rows and columns (20)')
    parser.add_argument('--count', type=int, default=200, help='round trips (200)')
    options = parser.parse_args()
    _environment.ensure()
    times = round_trips(options.side, options.count)
    print(f'{options.side} x {options.side}: median {1e3 * statistics.median(times):.3f} ms, '
          f'99 % {1e3 * statistics.quantiles(times, n=100)[-1]:.3f} ms')
    return 0


def round_trips(side: int, count: int) -> list[float]:
    """Return the time of each round trip of a float32 image [s], after the first few."""
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
    answers: list[Image] = []
    node.create_subscription(Image, 'back', answers.append, 10)
    publisher = node.create_publisher(Image, 'there', 10)
    while not (publisher.get_subscription_count() and node.count_publishers('back')):
        rclpy.spin_once(node, timeout_sec=0.1)
    time.sleep(0.5)
    image = frame_to_image(np.zeros((side, side)), Header())
    times = []
    for _ in range(count + 5):
        answers.clear()
        start = time.perf_counter()
        publisher.publish(image)
        while not answers:
            rclpy.spin_once(node, timeout_sec=1.0)
        times.append(time.perf_counter() - start)
    node.destroy_node()
    rclpy.shutdown()
    return times[5:]


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
