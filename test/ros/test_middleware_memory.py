# SPDX-License-Identifier: Apache-2.0
"""Nodes of a run free the memory of messages that have left their queues."""

import subprocess
import sys

from graph_runs import graph_environment
from graph_runs import own_domain
from lowsnr_bringup.run.middleware import middleware_environment

MESSAGES, MIB = 40, 4
# Two nodes of one process would share the memory.
NODE = f"""
import array
import sys
import time
import psutil
import rclpy
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image
rclpy.init()
node = rclpy.create_node(sys.argv[1])
until = time.monotonic() + 60.0
if sys.argv[1] == 'writer':
    publisher = node.create_publisher(Image, 'image', QoSProfile(depth={MESSAGES}))
    while not publisher.get_subscription_count():
        assert time.monotonic() < until
        time.sleep(0.01)
    for _ in range({MESSAGES}):
        publisher.publish(Image(data=array.array('B', bytes({MIB} * 2**20))))
    sys.stdin.read()
else:
    reader = node.create_subscription(Image, 'image', print, QoSProfile(depth={MESSAGES}))
    def resident():
        return psutil.Process().memory_info().rss / 2**20
    before = resident()
    while resident() < before + {MESSAGES * MIB}:
        assert time.monotonic() < until
        time.sleep(0.01)
    full, taken = resident(), 0
    while taken < {MESSAGES}:
        assert time.monotonic() < until
        with reader.handle:
            taken += reader.handle.take_message(Image, True) is not None
    print(full, resident())
"""


def test_memory_of_large_messages_is_freed(tmp_path):
    environment = graph_environment(own_domain())
    environment |= middleware_environment(environment, tmp_path, 'rmw_fastrtps_cpp')
    with subprocess.Popen([sys.executable, '-c', NODE, 'writer'], env=environment,
                          stdin=subprocess.PIPE) as writer:
        done = subprocess.run([sys.executable, '-c', NODE, 'reader'], env=environment,
                              capture_output=True, text=True, check=True)
        writer.stdin.close()
    full, after = map(float, done.stdout.split())
    assert full - after >= MESSAGES * MIB / 2
