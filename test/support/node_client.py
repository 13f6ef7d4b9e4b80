# SPDX-License-Identifier: Apache-2.0
"""A program beside a node in the process of a test: it sets parameters and exchanges messages."""

from lowsnr_common.core.records import Estimate
from lowsnr_common.ros import messages
from lowsnr_common.settings.declare import declared_settings
import numpy as np
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import DescribeParameters
from rcl_interfaces.srv import GetParameters
from rcl_interfaces.srv import SetParameters
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter import parameter_value_to_python
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray

SHAPE = (7, 5)


class NodeClient:
    """A node that sets the parameters of the node under test and receives what it publishes."""

    def __init__(self, context, spin, node):
        self.own, self.spin, self.node = Node('client', context=context), spin, node
        self.events, self.answers, self.tracks = [], [], []
        for kind, topic, heard in (
                (ParameterEvent, '/parameter_events', self.events),
                (Detection2DArray, 'detections', self.answers),
                (Detection2DArray, 'tracks', self.tracks)):
            self.own.create_subscription(kind, topic, heard.append, 100)
        self.frames = self.own.create_publisher(Image, 'image_raw', 100)
        self.arrays = self.own.create_publisher(Detection2DArray, 'detections', 100)
        self.stamp_s = 0
        spin(lambda: node.count_subscribers('/parameter_events'), node, self.own)

    def call(self, kind, service, request):
        """Return what a service of the node answers."""
        client = self.own.create_client(kind, f'{self.node.get_name()}/{service}')
        self.spin(client.service_is_ready)
        future = client.call_async(request)
        self.spin(future.done)
        self.own.destroy_client(client)
        return future.result()

    def set(self, name, value):  # noqa: A003
        """Set one parameter as ``ros2 param set`` does."""
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()])
        return self.call(SetParameters, 'set_parameters', request).results[0]

    def set_together(self, **values):
        """Set several at once; a name's dots are written as two underscores."""
        request = SetParametersAtomically.Request(parameters=[
            Parameter(name.replace('__', '.'), value=value).to_parameter_msg()
            for name, value in values.items()])
        return self.call(SetParametersAtomically, 'set_parameters_atomically', request).result

    def get(self, *names):
        """Return the values of parameters."""
        answer = self.call(GetParameters, 'get_parameters', GetParameters.Request(names=names))
        return [parameter_value_to_python(value) for value in answer.values]

    def describe(self, *names):
        """Return the descriptors of parameters."""
        request = DescribeParameters.Request(names=names)
        return self.call(DescribeParameters, 'describe_parameters', request).descriptors

    def changes(self):
        """Return names and new values of the parameters that were changed so far."""
        return [(item.name, parameter_value_to_python(item.value))
                for event in self.events for item in event.changed_parameters]

    def see(self, *bright, frames=1):
        """Have a detector answer frames of zeros but for one cell; return how many it declares."""
        self.spin(lambda: self.frames.get_subscription_count()
                  and self.node.count_subscribers('detections'))
        first = len(self.answers)
        for _ in range(frames):
            self.stamp_s += 1
            frame = np.zeros(SHAPE)
            if bright:
                frame[4, 3], = bright
            header = Header(stamp=messages.stamp_from_seconds(self.stamp_s), frame_id='sensor')
            self.frames.publish(messages.frame_to_image(frame, header))
        self.spin(lambda: len(self.answers) == first + frames)
        return [len(answer.detections) for answer in self.answers[first:]]

    def follow(self, *places):
        """Have a tracker answer an array of detections; return the ids of the tracks."""
        self.spin(lambda: self.arrays.get_subscription_count()
                  and self.node.count_subscribers('tracks'))
        first, self.stamp_s = len(self.tracks), self.stamp_s + 1
        found = [
            Estimate(np.array([x, 0.0, y, 0.0]), 0.3 * np.eye(4), 0.9) for x, y in places]
        header = Header(stamp=messages.stamp_from_seconds(self.stamp_s), frame_id='sensor')
        self.arrays.publish(messages.estimates_to_array(found, header, 1.0))
        self.spin(lambda: len(self.tracks) > first)
        return [item.id for item in self.tracks[-1].detections]


def live_names(node, *classes):
    """Return the parameters of settings classes that a node does not call read-only."""
    names = [name for cls in classes for name in declared_settings(cls)]
    return {name for name in names if not node.describe_parameter(name).read_only}
