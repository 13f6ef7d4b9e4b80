# SPDX-License-Identifier: Apache-2.0
"""The executor of nodes runs what rclpy's own would, also while entities come and go."""

import threading
import time

from lowsnr_common.ros.process.node_executor import NodeExecutor
import pytest
from rcl_interfaces.srv import GetParameters
from rclpy.clock import Clock
from rclpy.clock import ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Int64

DEPTH = QoSProfile(depth=100)
WITHIN_S = 30.0


@pytest.fixture
def executor(context):
    """Return an executor with the node ``there``."""
    made = NodeExecutor(context=context)
    made.add_node(Node('there', context=context))
    yield made
    for node in made.get_nodes():
        node.destroy_node()
    made.shutdown()


def spin_until(executor, condition):
    """Spin until a condition holds."""
    until = time.monotonic() + WITHIN_S
    while not condition():
        assert time.monotonic() < until
        executor.spin_once(timeout_sec=0.05)


def pair(executor, callback):
    """Return a publisher whose messages reach a callback, as plain numbers."""
    node, = executor.get_nodes()
    publisher = node.create_publisher(Int64, 'numbers', DEPTH)
    subscription = node.create_subscription(
        Int64, 'numbers', lambda message: callback(message.data), DEPTH)
    spin_until(executor, publisher.get_subscription_count)
    return publisher, subscription


def test_messages_arrive_in_order_and_in_turn_with_what_they_ask_for(executor):
    order = []

    def take(number):
        order.append(number)
        executor.call_soon(lambda: order.append(-number))

    publisher, _ = pair(executor, take)
    for number in range(1, 51):
        publisher.publish(Int64(data=number))
    spin_until(executor, lambda: len(order) == 100)
    assert order == [sign * number for number in range(1, 51) for sign in (1, -1)]


def test_timers_guards_services_and_entities_made_in_a_callback_are_run(executor):
    node, = executor.get_nodes()
    ran, steady = [], Clock(clock_type=ClockType.STEADY_TIME)

    def first():
        ran.append('timer')
        node.destroy_timer(timer)
        guard = node.create_guard_condition(lambda: ran.append('guard'))
        guard.trigger()

    timer = node.create_timer(0.01, first, clock=steady)
    spin_until(executor, lambda: ran == ['timer', 'guard'])
    client = node.create_client(GetParameters, 'there/get_parameters')
    assert client.wait_for_service(WITHIN_S)
    answer = client.call_async(GetParameters.Request(names=['use_sim_time']))
    spin_until(executor, answer.done)
    assert answer.result().values[0].bool_value is False
    assert ran == ['timer', 'guard']  # neither of them again


def test_a_subscription_that_another_callback_destroys_is_not_called(executor):
    node, = executor.get_nodes()
    called = []
    publisher, own = pair(executor, lambda _: leave('own', other))
    other = node.create_subscription(Int64, 'numbers', lambda _: leave('other', own), DEPTH)

    def leave(name, rival):
        called.append(name)
        if len(called) == 1:
            node.destroy_subscription(rival)

    spin_until(executor, lambda: publisher.get_subscription_count() == 2)
    for number in range(5):
        publisher.publish(Int64(data=number))
    spin_until(executor, lambda: len(called) == 5)
    assert len(set(called)) == 1


def test_what_a_callback_raises_reaches_the_caller(executor):
    def fail(number):
        raise ValueError(f'number {number}')

    publisher, _ = pair(executor, fail)
    publisher.publish(Int64(data=7))
    with pytest.raises(ValueError, match='number 7'):
        spin_until(executor, lambda: False)


def test_a_callback_that_awaits_is_refused(executor):
    node, = executor.get_nodes()

    async def wait():
        await client.call_async(GetParameters.Request())

    client = node.create_client(GetParameters, 'nobody/get_parameters')
    node.create_timer(0.01, wait, clock=Clock(clock_type=ClockType.STEADY_TIME))
    with pytest.raises(RuntimeError, match='awaits'):
        spin_until(executor, lambda: False)


def test_it_ends_when_its_context_ends_while_it_waits(executor, context):
    ending = threading.Timer(0.2, context.try_shutdown)
    ending.start()
    with pytest.raises(ExternalShutdownException):
        executor.spin()
    ending.join()


def test_it_ends_when_a_callback_ends_its_context(executor, context):
    node, = executor.get_nodes()
    node.create_timer(0.05, context.try_shutdown, clock=Clock(clock_type=ClockType.STEADY_TIME))
    executor.spin()
    assert not context.ok()
