# SPDX-License-Identifier: Apache-2.0
"""
From a frame to its tracks: the nodes of a chain as processes, and composed in one.

This process publishes the frames and takes the tracks, so that the time holds both ways, and no
other work.  The two ways and the bare round trip of an image are measured in turn.
"""

import argparse
from collections.abc import Callable
from collections.abc import Iterator
import contextlib
import os
from pathlib import Path
import statistics
import subprocess
import sys
import tempfile
import time
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / 'scripts'), str(ROOT / 'benchmarks')]

import _environment  # noqa: E402

DOMAIN, PERIOD_S, SKIPPED = '98', 0.01, 20  # the domain, unless the user has set one
WITHIN_S = 60.0  # for the nodes to start, and for the tracks of a frame
LAYER: dict[str, dict[str, Any]] = {
    '/**': {'autostart': True, 'seed': 0, 'sensor.snr_db': 9.0},
    'sdt_detector': {'operating_point': 'manual', 'threshold': 15.5, 'max_iterations': 5}}


def main() -> int:
    """Measure and print; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False,
        epilog='example: python benchmarks/chain_latency.py --rounds 5')
    parser.add_argument('--side', type=int, default=20, help='rows and columns (20)')
    parser.add_argument('--count', type=int, default=300, help='frames a round (300)')
    parser.add_argument('--rounds', type=int, default=3, help='rounds (3)')
    options = parser.parse_args()
    _environment.ensure()
    os.environ.setdefault('ROS_DOMAIN_ID', DOMAIN)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    from round_trip import round_trips
    times: dict[str, list[float]] = {'processes': [], 'composed': [], 'bare round trip': []}
    for _ in range(options.rounds):
        for name, found in times.items():
            found += (round_trips(options.side, options.count) if 'bare' in name else
                      chain_latencies(options.side, options.count, name == 'composed'))
    bare = statistics.median(times['bare round trip'])
    for name, found in times.items():
        tenths = statistics.quantiles(found, n=10)
        print(f'{name:<16} {options.side} x {options.side}: median '
              f'{1e3 * statistics.median(found):.3f} ms ({statistics.median(found) / bare:.2f} '
              f'round trips), 10 and 90 % {1e3 * tenths[0]:.3f} and {1e3 * tenths[-1]:.3f} ms')
    print(f'load {os.getloadavg()[0]:.1f}')
    return 0


@contextlib.contextmanager
def chain(side: int, composed: bool) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """Run detector and tracker, which start themselves; yield the processes by their nodes."""
    from lowsnr_bringup.plan import graph
    from lowsnr_bringup.plan.config_files import to_yaml
    from lowsnr_bringup.plan.node_command import by_process
    from lowsnr_bringup.plan.node_command import node_command

    nodes = [node for node in graph.run_nodes(['sdt'], composed=composed)
             if node.detector or node.name == 'tracker']
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as running:
        file = Path(folder) / 'parameters.yaml'
        size = {'/**': {'rows': side, 'cols': side}}
        file.write_text(to_yaml(graph.parameters(nodes, LAYER, size)), encoding='utf-8')
        processes = {}
        for each in by_process(nodes):
            module, arguments = node_command(dict.fromkeys(each, {}), file)
            process = subprocess.Popen(
                [sys.executable, '-m', module, *arguments],
                env=os.environ | {'PYTHONPATH': os.pathsep.join(sys.path)},
                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            running.callback(process.wait)
            running.callback(process.terminate)
            processes[' and '.join(node.name for node in each)] = process
        yield processes


def wait(
    condition: Callable[[], Any], node: Any, processes: dict[str, subprocess.Popen[bytes]],
) -> None:
    """Spin a node until a condition holds; end the program where that does not come about."""
    import rclpy

    until = time.monotonic() + WITHIN_S
    while not condition():
        rclpy.spin_once(node, timeout_sec=0.1)
        for name, process in processes.items():
            if process.poll() is not None:
                sys.exit(f'{name} ended with code {process.returncode}')
        if time.monotonic() > until:
            sys.exit(f'no answer of {", ".join(processes)} within {WITHIN_S:g} s: start it again '
                     'on a machine, or a ROS_DOMAIN_ID, with less load')


def chain_latencies(side: int, count: int, composed: bool) -> list[float]:
    """Return the time of each frame from before it is published until its tracks are here [s]."""
    from lowsnr_common.ros.messages import frame_to_image
    from lowsnr_common.ros.messages import stamp_from_seconds
    from lowsnr_common.ros.qos import reliable
    import numpy as np
    import rclpy
    from sensor_msgs.msg import Image
    from std_msgs.msg import Header
    from vision_msgs.msg import Detection2DArray

    rclpy.init()
    node = rclpy.create_node('camera')
    tracks: list[Detection2DArray] = []
    node.create_subscription(Detection2DArray, 'tracks', tracks.append, reliable(10))
    publisher = node.create_publisher(Image, 'image_raw', reliable(10))
    rng, times = np.random.default_rng(0), []
    with chain(side, composed) as processes:
        wait(lambda: publisher.get_subscription_count() and node.count_publishers('tracks')
             and (composed or node.count_subscribers('detections')), node, processes)
        time.sleep(1.0)
        for k in range(count + SKIPPED):
            image = frame_to_image(
                rng.standard_normal((side, side)), Header(stamp=stamp_from_seconds(k + 1.0)))
            tracks.clear()
            start = time.perf_counter()
            publisher.publish(image)
            wait(lambda: tracks, node, processes)
            times.append(time.perf_counter() - start)
            time.sleep(PERIOD_S)
    node.destroy_node()
    rclpy.shutdown()
    return times[SKIPPED:]


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
