# SPDX-License-Identifier: Apache-2.0
"""
A run on a camera of 16 bits: time to the first answer, frames unanswered, frame to track.

The camera is a program of its own beside the graph, with the middleware as ROS sets it up.  A
track array answers the frame of its stamp, and its time is measured where the camera is.
"""

import argparse
from collections.abc import Iterator
import contextlib
import os
from pathlib import Path
import signal
import statistics
import struct
import sys
import tempfile
import time
from typing import Any
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [
    str(ROOT / 'scripts'), str(ROOT / 'test' / 'support'), str(ROOT / 'benchmarks'),
    str(ROOT / 'src' / 'lowsnr_common')]

import _environment  # noqa: E402

TOPIC = '/camera/image_raw'
# Different frames, which are published in turn.
SCENES = 16
# Frames that count begin so long after the first answer [s].
SETTLED_S = 2.0
NANO = 1_000_000_000
INTERRUPTED = 130
# Share of two processors that nodes may take: a third is left to the camera and others.
GOAL = 2.0 * 2.0 / 3.0


class Stream(NamedTuple):
    """What became of the frames that count."""

    first_s: float  # from when bring-up has found the camera to its first answer
    counted: int
    spent_ms: list[float]  # from frame to track, of every frame that was answered, ascending
    frame_ms: dict[str, float]  # processor time of each node for a frame
    said: str  # what bring-up printed


def main() -> int:
    """Measure and print; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False,
        epilog='example: python benchmarks/camera_stream.py --side 512 --detector sdt')
    parser.add_argument('--side', type=int, default=1024, help='rows and columns (1024)')
    parser.add_argument('--rate', type=float, default=30.0, help='frames a second (30)')
    parser.add_argument('--seconds', type=float, default=60.0, help='length of the run [s] (60)')
    parser.add_argument('--detector', default='auto', help='the detector (auto)')
    parser.add_argument('--no-record', action='store_true', help='record no bag of the frames')
    options = parser.parse_args()
    _environment.ensure()
    from graph_runs import enter_own_domain
    enter_own_domain()
    found = measure(
        options.side, options.rate, options.seconds, options.detector, not options.no_record)
    spent, frame_ms = found.spent_ms, found.frame_ms
    print(found.said)
    print(f'camera found to first answer: {found.first_s:.2f} s')
    print(f'unanswered: {found.counted - len(spent)} of {found.counted} frames')
    if len(spent) > 1:
        print(f'frame to track: {statistics.median(spent):.1f} ms (median), '
              f'{statistics.quantiles(spent, n=100)[98]:.1f} ms (99 %)')
    print(f'processor time a frame: {sum(frame_ms.values()):.1f} ms ('
          + ', '.join(f'{name} {spent_ms:.1f}' for name, spent_ms in frame_ms.items())
          + f'), goal {1e3 * GOAL / options.rate:.0f} ms')
    return 0


def measure(side: int, rate_hz: float, seconds: float, detector: str, record: bool) -> Stream:
    """Run a graph on a camera for so long after its start."""
    with camera() as (publish, answered), graph(detector, record) as run:
        sent, before = stream(publish, answered, run, side, rate_hz, seconds)
        if run.process.poll() is not None:
            raise RuntimeError(run.finish()[2])
        found = (run.results / 'parameters.yaml').stat().st_mtime
        after = cpu_s(run)
        run.process.send_signal(signal.SIGINT)
        code, said, err = run.finish()
    if code != INTERRUPTED:
        raise RuntimeError(err)
    answers = {stamp: at for stamp, at in answered.items() if stamp in sent}
    if not answers:
        raise RuntimeError('no frame was answered')
    first = min(answers.values())
    counted = [stamp for stamp in sent if stamp / NANO > first + SETTLED_S][:-1]
    return Stream(
        first - found, len(counted),
        sorted(1e3 * (answers[stamp] - sent[stamp]) for stamp in counted if stamp in answers),
        {name: 1e3 * (used - before.get(name, 0.0)) / max(len(counted), 1)
         for name, used in after.items()}, said)


@contextlib.contextmanager
def camera() -> Iterator[tuple[Any, dict[int, float]]]:
    """Yield a publisher of the frames, and the times at which tracks of stamps [ns] arrived."""
    import threading

    from lowsnr_common.core.process_setup import keep_freed_memory
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import Image
    from vision_msgs.msg import Detection2DArray

    keep_freed_memory()  # otherwise most of what a large frame costs here is new memory for it
    rclpy.init()
    node, answered = Node('camera'), {}

    def hear(message: Any) -> None:
        stamp = message.header.stamp
        answered[stamp.sec * NANO + stamp.nanosec] = time.time()

    node.create_subscription(Detection2DArray, '/tracks', hear, QoSProfile(depth=1000))
    publisher = node.create_publisher(Image, TOPIC, QoSProfile(depth=30))
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    try:
        yield publisher.publish, answered
    finally:
        executor.shutdown()
        thread.join()
        node.destroy_node()
        rclpy.shutdown()


@contextlib.contextmanager
def graph(detector: str, record: bool) -> Iterator[Any]:
    """Start the graph on the camera; it ends with the block."""
    from graph_runs import own_domain
    from graph_runs import start_bringup

    with tempfile.TemporaryDirectory() as folder, start_bringup(
            Path(folder) / 'run', '--camera', TOPIC, '--camera-within', '60', '--detector',
            detector, '--snr', '8', *(['--record', str(Path(folder) / 'bag')] if record else []),
            domain_id=own_domain()) as run:
        yield run


def stream(
    publish: Any, answered: dict[int, float], run: Any, side: int, rate_hz: float, seconds: float,
) -> tuple[dict[int, float], dict[str, float]]:
    """
    Publish frames until the graph has answered for so long.

    Return when, by stamp [ns], and the processor times of the nodes when frames begin to count.
    """
    messages = frames(side)
    sent: dict[int, float] = {}
    before: dict[str, float] = {}
    start, until = time.time(), time.time() + 60.0 + seconds
    while time.time() < until:
        time.sleep(max(0.0, start + len(sent) / rate_hz - time.time()))
        now = time.time()
        data = messages[len(sent) % SCENES]
        struct.pack_into('<iI', data, 4, *divmod(stamp := int(now * NANO), NANO))
        sent[stamp] = now
        publish(bytes(data))
        if answered:
            settled = min(answered.values()) + SETTLED_S
            until = min(until, settled + seconds)
            if not before and now > settled:
                before = cpu_s(run)
    return sent, before


def frames(side: int) -> list[bytearray]:
    """Return serialized frames of structures of 16 pixels and noise of 20 grey steps."""
    import numpy as np
    from rclpy.serialization import serialize_message
    from sensor_msgs.msg import Image

    rng, found = np.random.default_rng(0), []
    blocks = rng.standard_normal((side // 16 + 1, side // 16 + 1))
    scene = 1000.0 + 50.0 * np.kron(blocks, np.ones((16, 16)))[:side, :side]
    for _ in range(SCENES):
        frame = scene + 20.0 * rng.standard_normal((side, side))
        found.append(bytearray(serialize_message(Image(
            height=side, width=side, encoding='mono16', step=2 * side,
            data=frame.astype('<u2').tobytes()))))
    return found


def cpu_s(run: Any) -> dict[str, float]:
    """Return the processor time that each node has used [s]."""
    used = {}
    for name, pid in run.processes():
        fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
        used[name] = (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')
    return used


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
