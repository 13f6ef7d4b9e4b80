# SPDX-License-Identifier: Apache-2.0
"""
Rows of the time from a frame to its tracks, the nodes as processes and composed in one.

This process publishes the frames and takes the tracks, so that its clock holds the whole way, and
does no other work: a node that is busy sees frames and tracks late, and the time between them
too short.  The two ways and the bare round trip of an image are timed in turn.
"""

from collections.abc import Callable
from collections.abc import Iterator
import contextlib
import functools
import os
from pathlib import Path
import statistics
import subprocess
import sys
import tempfile
import time
from typing import Any

from round_trip import round_trips
from rows.row import Figure
from rows.row import Measurement

SIDE, COUNT, ROUNDS = 20, 300, 3
COMPOSED_MS, OVER_HOPS = 0.8, 4.0
# Frames to the detector, detections to the tracker, tracks to this process; a round trip has two.
HOPS = 3
PERIOD_S, SKIPPED = 0.01, 20
WITHIN_S = 60.0  # for the nodes to start, and for the tracks of a frame
LAYER: dict[str, dict[str, Any]] = {
    '/**': {'autostart': True, 'seed': 0, 'sensor.snr_db': 9.0},
    'sdt_detector': {'operating_point': 'manual', 'threshold': 15.5, 'max_iterations': 5}}


def measurements() -> list[Measurement]:
    """Return the rows."""
    what = f'{SIDE} x {SIDE}: frame to track'
    return [
        Measurement(f'nodes as processes, {what}, over {HOPS} bare hops', f'{OVER_HOPS:g}', apart),
        Measurement(f'composed chain, {what}', f'{COMPOSED_MS:g} ms', composed)]


def apart() -> Figure:
    """Compare the chain of processes with a bare image on as many hops."""
    ms, bare_ms = medians_ms()['processes'], medians_ms()['bare']
    hops_ms = HOPS * bare_ms / 2
    return Figure(f'{ms / hops_ms:.1f} ({ms:.2f} ms, {hops_ms:.2f} ms)', ms <= OVER_HOPS * hops_ms)


def composed() -> Figure:
    """Time the chain in one process."""
    ms, bare_ms = medians_ms()['composed'], medians_ms()['bare']
    return Figure(f'{ms:.2f} ms (bare round trip {bare_ms:.2f} ms)', ms <= COMPOSED_MS)


@functools.cache
def medians_ms() -> dict[str, float]:
    """Return the median time of both ways and of a bare round trip."""
    times: dict[str, list[float]] = {'processes': [], 'composed': [], 'bare': []}
    for _ in range(ROUNDS):
        for way, found in times.items():
            found += (round_trips(SIDE, COUNT) if way == 'bare' else
                      chain_latencies(SIDE, COUNT, way == 'composed'))
    return {way: 1e3 * statistics.median(found) for way, found in times.items()}


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
    """Spin a node until a condition holds; raise where that does not come about."""
    import rclpy

    until = time.monotonic() + WITHIN_S
    while not condition():
        rclpy.spin_once(node, timeout_sec=0.1)
        for name, process in processes.items():
            if process.poll() is not None:
                raise RuntimeError(f'{name} ended with code {process.returncode}')
        if time.monotonic() > until:
            raise TimeoutError(f'no answer of {", ".join(processes)} within {WITHIN_S:g} s: '
                               'start it again on a machine with less load')


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
    try:
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
    finally:
        node.destroy_node()
        rclpy.shutdown()
    return times[SKIPPED:]
