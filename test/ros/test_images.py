# SPDX-License-Identifier: Apache-2.0
"""Images of every kind of camera are read as they are; malformed ones are refused by name."""

import array
import re

from lowsnr_common.core.records import Malformed
from lowsnr_common.ros.images import image_to_array
from lowsnr_common.ros.images import image_to_whole_array
import numpy as np
import pytest
from sensor_msgs.msg import Image

KINDS = {'mono8': 'u1', '8UC1': 'u1', 'mono16': 'u2', '16UC1': 'u2', '32FC1': 'f4'}


def image(frame, encoding, order, padding=0):
    """Return a message whose rows are followed by some bytes."""
    rows = frame.astype(np.dtype(KINDS[encoding]).newbyteorder(order))
    data = b''.join(row.tobytes() + b'\xff' * padding for row in rows)
    return Image(
        height=frame.shape[0], width=frame.shape[1], encoding=encoding,
        is_bigendian=int(order == '>'), step=len(data) // len(frame), data=array.array('B', data))


@pytest.mark.parametrize('padding', [0, 3])
@pytest.mark.parametrize('order', ['<', '>'])
@pytest.mark.parametrize('encoding', KINDS)
def test_every_encoding_byte_order_and_step_is_read(rng, grid_shape, encoding, order, padding):
    most = 250 if KINDS[encoding] == 'u1' else 60_000
    frame = rng.integers(most, size=grid_shape).astype(KINDS[encoding])
    read = image_to_array(image(frame, encoding, order, padding))
    np.testing.assert_array_equal(read, frame)
    assert read.dtype.kind == frame.dtype.kind


@pytest.mark.parametrize(('field', 'value', 'reason', 'numbers'), [
    ('step', 9, 'wrong step', {'9', '10'}),
    ('step', 11, 'wrong size', {'70', '77'}),
    ('height', 8, 'wrong size', {'70', '80'}),
    ('width', 0, 'empty frame', {'0', '7'}),
])
def test_malformed_image_is_rejected_with_its_values(grid_shape, field, value, reason, numbers):
    message = image(np.zeros(grid_shape), 'mono16', '<')
    setattr(message, field, value)
    with pytest.raises(Malformed) as caught:
        image_to_array(message)
    assert caught.value.reason == reason
    assert set(re.findall(r'\d+', str(caught.value))) == numbers


def test_unknown_encoding_is_rejected_with_those_that_are_taken(grid_shape):
    message = image(np.zeros(grid_shape), 'mono16', '<')
    message.encoding = '32FC3'
    with pytest.raises(Malformed, match="'32FC3'.*mono8.*rgb8") as caught:
        image_to_array(message)
    assert caught.value.reason == 'wrong encoding'


def test_value_that_is_not_finite_is_rejected_with_its_place(grid_shape):
    frame = np.zeros(grid_shape)
    frame[3, 1] = np.nan
    message = image(frame, '32FC1', '<')
    with pytest.raises(Malformed, match='row 3, column 1') as caught:
        image_to_whole_array(message)
    assert caught.value.reason == 'cell not a finite number'
    np.testing.assert_array_equal(image_to_array(message), frame)


@pytest.mark.parametrize(('value', 'fits'), [
    (1e9, True), (-1e9, True), (1.1e9, False), (-1.1e9, False), (3.4e38, False)])
@pytest.mark.parametrize('order', ['<', '>'])
def test_value_that_overflows_when_squared_is_rejected(grid_shape, value, fits, order):
    frame = np.zeros(grid_shape)
    frame[3, 1] = value
    message = image(frame, '32FC1', order)
    if fits:
        assert image_to_array(message)[3, 1] == image_to_whole_array(message)[3, 1] == value
        return
    with pytest.raises(Malformed, match='row 3, column 1') as caught:
        image_to_whole_array(message)
    assert caught.value.reason == 'cell beyond 1e9'
    frame[3, 1] = np.nan
    read = image_to_array(message)
    np.testing.assert_array_equal(read, frame)
    assert read.dtype == np.float32


def test_header_of_a_huge_frame_without_data_costs_nothing():
    message = Image(height=16384, width=16384, encoding='32FC1', step=65536)
    with pytest.raises(Malformed, match='1073741824') as caught:
        image_to_array(message)
    assert caught.value.reason == 'wrong size'
