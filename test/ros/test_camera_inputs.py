# SPDX-License-Identifier: Apache-2.0
"""A camera is heard whatever it offers and however it packs its frames, also if it comes late."""

import cv2
from lowsnr_common.ros import messages
from lowsnr_common.ros.connections import OTHER_QOS
from lowsnr_sensor.conditioner_node import ConditionerNode
import numpy as np
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CompressedImage
from sensor_msgs.msg import Image
from std_msgs.msg import Header

DEPTH = QoSProfile(depth=1000)


@pytest.fixture
def other(context):
    node = Node('other', context=context)
    yield node
    node.destroy_node()


@pytest.mark.parametrize(('qos', 'in_effect'), [
    (qos_profile_sensor_data, 'BEST_EFFORT'), (DEPTH, 'RELIABLE')])
def test_camera_that_comes_late_is_heard_as_it_sends_and_never_incompatible(
        context, other, spin, qos, in_effect):
    node = ConditionerNode(context=context, parameter_overrides=[Parameter('live', value=True)])
    node.trigger_configure()
    camera = other.create_publisher(Image, 'image_raw', qos)

    def reliabilities():
        node.report()
        return [item.qos_profile.reliability.name
                for item in other.get_subscriptions_info_by_topic('/image_raw')]
    spin(lambda: reliabilities() == [in_effect] and camera.get_subscription_count(), node, other)
    node.trigger_activate()
    for _ in range(3):
        node.report()
        assert not [fault for fault in node._faults if fault.reason == OTHER_QOS]
    node.destroy_node()


def test_frames_of_a_compressed_camera_are_received_and_others_rejected(context, other, spin):
    node = ConditionerNode(context=context, parameter_overrides=[
        Parameter('live', value=True), Parameter('compressed', value=True)])
    node.autostart()
    answers = []
    other.create_subscription(Image, 'conditioned/image_raw', answers.append, DEPTH)
    camera = other.create_publisher(CompressedImage, 'image_raw', DEPTH)
    spin(lambda: node.count_subscribers('conditioned/image_raw')
         and camera.get_subscription_count(), node, other)
    data = cv2.imencode('.png', np.full((8, 8), 1000, np.uint16))[1].tobytes()
    for k, how in enumerate(['mono16; png compressed', '16UC1; compressedDepth png']):
        camera.publish(CompressedImage(
            header=Header(stamp=messages.stamp_from_seconds(1.0 + k)), format=how, data=data))
    spin(lambda: answers and node.counts['refused'])
    assert (len(answers), node.counts['image_raw wrong encoding']) == (1, 1)
    node.destroy_node()
