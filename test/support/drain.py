# SPDX-License-Identifier: Apache-2.0
"""Messages that wait in the queue of a subscription of a test."""

from lowsnr_common.ros.inputs import take_waiting


def drain(subscription):
    """Pass the messages in the queue of a subscription to its callback; a spin takes one."""
    for message, _ in take_waiting(subscription):
        subscription.callback(message)
