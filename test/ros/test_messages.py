# SPDX-License-Identifier: Apache-2.0
"""Records and frames survive the way through messages; malformed images are refused by name."""

import array

from builtin_interfaces.msg import Time
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Malformed
from lowsnr_common.core.records import Prediction
from lowsnr_common.ros import messages
import numpy as np
import pytest
from std_msgs.msg import Header
from vision_msgs.msg import Detection2D
from vision_msgs.msg import Detection2DArray

CELL = 2.0


@pytest.fixture
def image(grid_shape, rng):
    frame = rng.standard_normal(grid_shape).astype(np.float32)
    return messages.frame_to_image(frame, Header(frame_id='sensor'))


def test_frame_comes_back_as_it_was(grid_shape, rng):
    frame = rng.standard_normal(grid_shape).astype(np.float32)
    image = messages.frame_to_image(frame, Header())
    assert (image.height, image.width, image.step) == (7, 5, 20)
    np.testing.assert_array_equal(messages.image_to_frame(image), frame)


def test_other_byte_order_and_padded_rows_are_read(grid_shape, rng):
    frame = rng.standard_normal(grid_shape).astype(np.float32)
    padded = np.pad(frame, ((0, 0), (0, 3)), constant_values=np.nan)
    image = messages.frame_to_image(padded, Header())
    image.data = array.array('B', padded.astype('>f4').tobytes())
    image.is_bigendian, image.width = 1, grid_shape[1]
    np.testing.assert_array_equal(messages.image_to_frame(image), frame)


@pytest.mark.parametrize(('field', 'value', 'said'), [
    ('encoding', 'mono8', "encoding is 'mono8', must be '32FC1'"),
    ('step', 16, 'step is 16 bytes, must be at least 20'),
    ('step', 21, 'data holds 140 bytes, must be 147'),
    ('height', 8, 'data holds 140 bytes, must be 160'),
    ('width', 0, 'frame of 0 x 7 cells is empty'),
])
def test_malformed_image_is_refused(image, field, value, said):
    setattr(image, field, value)
    with pytest.raises(ValueError, match=said):
        messages.image_to_frame(image)


@pytest.mark.parametrize('value', [np.nan, np.inf, -np.inf])
def test_value_that_is_not_finite_is_refused(grid_shape, value):
    frame = np.zeros(grid_shape)
    frame[3, 1] = value
    with pytest.raises(ValueError, match='row 3, column 1 is not a finite number'):
        messages.image_to_frame(messages.frame_to_image(frame, Header()))


def test_estimate_goes_over_the_wire_in_pixels():
    estimate = Estimate(np.array([6.0, 1.0, 8.0, -2.0]), np.diag([4.0, 1.0, 8.0, 1.0]), 0.75, 'a')
    message = messages.estimates_to_array([estimate], Header(), CELL)
    one = message.detections[0]
    assert (one.bbox.center.position.x, one.bbox.center.position.y) == (3.0, 4.0)
    assert one.results[0].pose.covariance[0] == 1.0
    assert one.results[0].pose.covariance[7] == 2.0
    assert one.results[0].hypothesis.score == 0.75
    back = messages.array_to_estimates(message, CELL)[0]
    np.testing.assert_array_equal(back.state[[0, 2]], estimate.state[[0, 2]])
    np.testing.assert_array_equal(back.cov[np.ix_([0, 2], [0, 2])], np.diag([4.0, 8.0]))
    assert np.isnan(back.state[[1, 3]]).all()
    assert (back.id, back.score) == ('a', 0.75)


def test_prediction_of_a_detector_is_a_second_result(rng):
    root = rng.standard_normal((2, 2))
    predicted = Prediction(0.25, np.array([5.0, 9.0]), root @ root.T)
    given = [Estimate(np.array([6.0, 0.0, 8.0, 0.0]), np.eye(4), 0.75, 'a', predicted),
             Estimate(np.zeros(4), np.eye(4), 0.5)]
    message = messages.estimates_to_array(given, Header(), CELL)
    assert [[r.hypothesis.class_id for r in one.results] for one in message.detections] == [
        ['object', 'predicted'], ['object']]
    with_one, without = messages.array_to_estimates(message, CELL)
    assert with_one.score == 0.75
    assert with_one.predicted.score == 0.25
    np.testing.assert_allclose(with_one.predicted.position, predicted.position)
    np.testing.assert_allclose(with_one.predicted.cov, predicted.cov)
    assert without.predicted is None
    message.detections[0].results[1].hypothesis.class_id = 'bird'  # of a detector of another kind
    assert messages.array_to_estimates(message, CELL)[0].predicted is None


def test_odometry_carries_the_velocity_and_both_covariances(rng):
    root = rng.standard_normal((4, 4))
    estimate = Estimate(rng.standard_normal(4), root @ root.T, 0.9, '7')
    message = messages.estimate_to_odometry(estimate, Header())
    back = messages.odometry_to_estimate(message, 0.9)
    np.testing.assert_array_equal(back.state, estimate.state)
    assert message.child_frame_id == back.id == '7'
    for part in ([0, 2], [1, 3]):
        block = np.ix_(part, part)
        np.testing.assert_array_equal(back.cov[block], estimate.cov[block])


@pytest.mark.parametrize('seconds', [1.0, 40.0, 0.1 + 0.2, 1_795_314_438.781545])
def test_stamp_is_exact_to_the_nanosecond(seconds):
    stamp = messages.stamp_from_seconds(seconds)
    assert abs(messages.stamp_key(stamp) - seconds * 1e9) <= max(1.0, seconds * 1e9 * 2**-52)


def test_detection_without_result_has_no_score():
    message = messages.estimates_to_array(
        [Estimate(np.zeros(4), np.eye(4), 1.0)], Header(), CELL)
    message.detections[0].results = []
    back = messages.array_to_estimates(message, CELL)[0]
    assert back.score == 0.0
    assert np.isnan(back.cov).all()


def entries(*places, ids=None):
    """Return an array of entries at places (x, y) [m]."""
    ids = ids or [''] * len(places)
    return messages.estimates_to_array(
        [Estimate(np.array([x, 0.0, y, 0.0]), np.eye(4), 1.0, name)
         for (x, y), name in zip(places, ids)], Header(), CELL)


def test_sound_array_is_read_as_any_other():
    message = entries((1, 2), (-1e8, 1e8), (3, 4), ids=['a', '', ''])
    read, sound = (function(message, CELL) for function in (
        messages.array_to_estimates, messages.array_to_sound_estimates))
    assert [item.id for item in sound] == ['a', '', '']
    assert str(sound) == str(read)


@pytest.mark.parametrize(('message', 'reason', 'said'), [
    (entries((1, 2), (np.nan, 2)), 'no place', r'\(nan, 2\) m'),
    (entries((1, np.inf)), 'no place', r'\(1, inf\) m'),
    (entries((1e300, 2)), 'no place', r'\(1e\+300, 2\) m'),
    (entries((1, 2), (3, 4), ids=['a', 'a']), 'id of two entries', "'a'"),
    (entries((1, 2), ids=['x' * 10**6]), 'id too long', '1000000 .* 255'),
])
def test_array_with_impossible_values_is_rejected_with_its_reason(message, reason, said):
    with pytest.raises(Malformed, match=said) as caught:
        messages.array_to_sound_estimates(message, CELL)
    assert caught.value.reason == reason
    assert len(str(caught.value)) < 100


def test_more_than_ten_thousand_entries_are_rejected():
    message = Detection2DArray(detections=[Detection2D()] * 10_001)
    with pytest.raises(Malformed, match='10001') as caught:
        messages.array_to_estimates(message, CELL)
    assert caught.value.reason == 'too many entries'
    message.detections = message.detections[1:]
    assert len(messages.array_to_estimates(message, CELL)) == 10_000


@pytest.mark.parametrize(('state', 'reason'), [
    ((np.nan, 0, 0, 0), 'no place'), ((0, 0, -np.inf, 0), 'no place'),
    ((0, np.inf, 0, 0), 'no velocity'), ((0, 0, 0, -1e300), 'no velocity')])
def test_odometry_with_impossible_values_is_rejected_with_its_reason(state, reason):
    message = messages.estimate_to_odometry(
        Estimate(np.array(state, dtype=float), np.eye(4), 1.0, 'a'), Header())
    with pytest.raises(Malformed) as caught:
        messages.odometry_to_estimate(message, 1.0)
    assert caught.value.reason == reason


def test_velocity_may_be_unknown():
    message = messages.estimate_to_odometry(
        Estimate(np.array([1, np.nan, 2, np.nan]), np.eye(4), 1.0, 'a'), Header())
    assert np.isnan(messages.odometry_to_estimate(message, 1.0).state[[1, 3]]).all()


@pytest.mark.parametrize(('sec', 'nanosec'), [
    (0, 0), (-1, 5), (2**31 - 1, 2**32 - 1), (-2**31, 0), (3, 2_000_000_000)])
def test_any_stamp_has_a_place_in_time(sec, nanosec):
    assert messages.stamp_key(Time(sec=sec, nanosec=nanosec)) == sec * 10**9 + nanosec
