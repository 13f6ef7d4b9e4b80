# SPDX-License-Identifier: Apache-2.0
"""What waits in the queue of a subscription is taken at once, and no more than that."""

from drain import drain
from lowsnr_common.ros.qos import reliable
from rclpy.node import Node
from std_msgs.msg import Header


def test_drain_ends_though_messages_arrive_faster_than_they_are_taken(context, spin):
    node = Node('busy', context=context)
    taken, depth = [], reliable(4)
    publisher = node.create_publisher(Header, 'busy', depth)

    def send():
        publisher.publish(Header())
        assert publisher.wait_for_all_acked()

    def take(message):
        taken.append(message)
        if len(taken) < 50:
            send()

    reader = node.create_subscription(Header, 'busy', take, depth)
    spin(publisher.get_subscription_count, node)
    for _ in range(4):
        send()
    for count in (4, 8):
        drain(reader)
        assert len(taken) == count
    node.destroy_node()
