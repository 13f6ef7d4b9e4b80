# SPDX-License-Identifier: Apache-2.0
"""
Record large frames for a minute and count the lost ones.

``python benchmarks/recording.py`` publishes frames of 1024 x 1024 float32 at 30 a second for
60 s; the recorder node records them into an MCAP bag, which the benchmark deletes at its end.
"""

import argparse
import os
from pathlib import Path
import shutil
import struct
import sys
import tempfile
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rclpy.publisher import Publisher

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / 'scripts'), str(ROOT / 'test' / 'support'),
                *map(str, sorted((ROOT / 'src').glob('lowsnr*')))]
TOPIC = '/image_raw'


def parse_arguments() -> argparse.Namespace:
    """Return the options."""
    parser = argparse.ArgumentParser(prog='recording.py', description=__doc__)
    parser.add_argument('--side', type=int, default=1024, help='rows and columns of a frame')
    parser.add_argument('--rate', type=float, default=30.0, help='frames a second')
    parser.add_argument('--seconds', type=float, default=60.0, help='duration [s]')
    parser.add_argument('--storage', choices=('mcap', 'sqlite3'), default='mcap')
    parser.add_argument('--folder', type=Path, help='where to write the bag (default: temporary)')
    return parser.parse_args()


def publish(publisher: 'Publisher', options: argparse.Namespace) -> tuple[int, float]:
    """Publish the frames; return their number and the largest delay of one [s]."""
    from lowsnr_common.ros import messages
    import numpy as np
    from rclpy.serialization import serialize_message
    from std_msgs.msg import Header

    noise = np.random.default_rng(0).standard_normal(
        (options.side, options.side), dtype=np.float32)
    data = bytearray(serialize_message(messages.frame_to_image(noise, Header())))
    count, start, latest = round(options.rate * options.seconds), time.monotonic(), 0.0
    for k in range(count):
        due = start + k / options.rate
        time.sleep(max(0.0, due - time.monotonic()))
        latest = max(latest, time.monotonic() - due)
        stamp_ns = round(k * 1e9 / options.rate)
        struct.pack_into('<iI', data, 4, *divmod(stamp_ns, 1_000_000_000))
        publisher.publish(bytes(data))
    return count, latest


def record(folder: Path, options: argparse.Namespace) -> tuple[int, float, float]:
    """Run publisher and recorder; return frames sent, largest delay and recorder's CPU [s]."""
    from lowsnr_bringup.plan.config_files import to_yaml
    from lowsnr_bringup.plan.graph import Node
    from lowsnr_bringup.plan.parts import Part
    from lowsnr_bringup.ros.manager import ACTIVATE
    from lowsnr_bringup.ros.manager import CONFIGURE
    from lowsnr_bringup.ros.manager import DEACTIVATE
    from lowsnr_bringup.ros.manager import Manager
    from lowsnr_bringup.run.processes import ProcessGroup
    from lowsnr_common.ros.qos import frame_depth
    from lowsnr_common.ros.qos import reliable
    import rclpy
    from rclpy.duration import Duration
    from sensor_msgs.msg import Image

    node = Node('recorder', 'lowsnr_bringup.recorder_node')
    (folder / 'parameters.yaml').write_text(to_yaml({node.path: {
        'autostart': False, 'bag': str(folder / 'bag'), 'storage': options.storage,
        'topics': [TOPIC], 'rows': options.side, 'cols': options.side}}))
    with ProcessGroup(folder, os.environ) as group:
        recorder = group.start(node, folder / 'parameters.yaml')
        manager = Manager(group, Part((node,)), lambda: None, lambda *_: None)
        rclpy.init()
        publisher = rclpy.create_node('camera').create_publisher(
            Image, TOPIC, reliable(frame_depth(1000, options.side, options.side)))
        manager.change(node, CONFIGURE, 60.0)
        manager.change(node, ACTIVATE, 30.0)
        while not publisher.get_subscription_count():
            time.sleep(0.01)
        sent, latest = publish(publisher, options)
        publisher.wait_for_all_acked(Duration(seconds=30))
        ticks = Path(f'/proc/{recorder.process.pid}/stat').read_text().split()[13:15]
        manager.change(node, DEACTIVATE, 60.0)
        manager.close()
        rclpy.shutdown()
    return sent, latest, sum(map(int, ticks)) / os.sysconf('SC_CLK_TCK')


def main() -> int:
    """Record; return 1 if any frame was lost."""
    import _environment
    _environment.ensure()
    options = parse_arguments()
    folder = Path(tempfile.mkdtemp(prefix='recording-', dir=options.folder))
    from graph_runs import enter_own_domain
    enter_own_domain()
    from lowsnr_bringup.bags.recorded_run import inspect_bag
    from lowsnr_bringup.bags.recording import summarize_recording
    from lowsnr_bringup.run.domain import claim_domain
    from lowsnr_bringup.run.middleware import middleware_environment
    from rclpy import get_rmw_implementation_identifier
    size = 4 * options.side**2
    claim = claim_domain()
    os.environ |= middleware_environment(os.environ, folder, get_rmw_implementation_identifier())
    try:
        start = time.monotonic()
        sent, latest, cpu_s = record(folder, options)
        print(f'{sent} frames of {size / 1e6:.3g} MB in {time.monotonic() - start:.1f} s')
        print(f'target {size * options.rate / 1e6:.4g} MB/s; latest frame {latest:.3f} s late; '
              f'recorder {cpu_s / options.seconds:.0%} of a core')
        print(summarize_recording(folder / 'bag'))
        found = inspect_bag(folder / 'bag', TOPIC, '/ground_truth')
        print(f'{found.frames} frames read back, {sent - found.frames} missing')
        return int(found.frames != sent)
    finally:
        shutil.rmtree(folder)
        claim.close()


if __name__ == '__main__':
    sys.exit(main())
