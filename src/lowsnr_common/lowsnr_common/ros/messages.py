# SPDX-License-Identifier: Apache-2.0
"""Frames and records to messages and back: the one place that knows both."""

from __future__ import annotations

import array
from collections.abc import Iterable
import sys

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovariance
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Malformed
from lowsnr_common.core.records import Prediction
from lowsnr_common.ros.images import image_to_whole_array
from lowsnr_common.ros.images import LocalFrame
from nav_msgs.msg import Odometry
import numpy as np
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2D
from vision_msgs.msg import Detection2DArray
from vision_msgs.msg import ObjectHypothesisWithPose

ENCODING = '32FC1'
# The second result of an entry is what its detector expected before the frame.
CLASS_ID, PREDICTED_ID = 'object', 'predicted'
# Places of x and y in the row-major 6 x 6 covariance of a pose or twist.
_XY, _COV = np.ix_([0, 1], [0, 1]), (0, 1, 6, 7)
# What an entry without a result is taken to say: nothing.
_NO_RESULT = ObjectHypothesisWithPose()
_NO_RESULT.pose.covariance = np.full(36, np.nan)
# What an array or an odometry of ours never exceeds: entries, letters of an id, metres or m/s.
_MOST_ENTRIES, _LONGEST_ID, _FARTHEST = 10_000, 255, 1e9


def stamp_from_seconds(seconds: float) -> Time:
    """Return a time in seconds as a stamp, to the nanosecond."""
    total = round(seconds * 1e9)
    return Time(sec=total // 1_000_000_000, nanosec=total % 1_000_000_000)


def stamp_key(stamp: Time) -> int:
    """Return a stamp as whole nanoseconds, for comparison and as a dictionary key."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def frame_to_image(frame: np.ndarray, header: Header) -> Image:
    """Return a (rows, cols) frame as a 32FC1 image in this machine's byte order."""
    data = array.array('B')
    data.frombytes(np.ascontiguousarray(frame, dtype=np.float32).data.cast('B'))
    return Image(
        header=header, height=frame.shape[0], width=frame.shape[1], encoding=ENCODING,
        is_bigendian=int(sys.byteorder == 'big'), step=4 * frame.shape[1], data=data)


def image_to_frame(image: Image | LocalFrame) -> np.ndarray:
    """
    Return a 32FC1 image as a frame.

    Returns
    -------
    (rows, cols) ndarray of float64
        Cell intensities.

    Raises
    ------
    Malformed
        If encoding, step or size do not fit, or a value is not finite or beyond 1e9; says which.

    """
    if not isinstance(image, LocalFrame) and image.encoding != ENCODING:
        raise Malformed(
            'wrong encoding', f'encoding is {image.encoding[:40]!r}, must be {ENCODING!r}')
    return image_to_whole_array(image).astype(float)


def estimates_to_array(
    estimates: Iterable[Estimate], header: Header, cell_size_m: float,
) -> Detection2DArray:
    """Return detections, tracks or truth as one array, positions in pixels."""
    message = Detection2DArray(header=header)
    message.detections = [_to_detection(item, header, cell_size_m) for item in estimates]
    return message


def _to_detection(item: Estimate, header: Header, cell_size_m: float) -> Detection2D:
    x, y = (float(value) for value in item.state[POS] / cell_size_m)
    result = ObjectHypothesisWithPose()
    result.hypothesis.class_id = CLASS_ID
    result.hypothesis.score = item.score
    _fill_pose(result.pose, x, y, item.cov[np.ix_(POS, POS)] / cell_size_m**2)
    message = Detection2D(header=header, id=item.id, results=[result])
    if item.predicted is not None:
        message.results.append(_to_prediction(item.predicted, cell_size_m))
    message.bbox.center.position.x, message.bbox.center.position.y = x, y
    message.bbox.size_x = message.bbox.size_y = 1.0
    return message


def _to_prediction(item: Prediction, cell_size_m: float) -> ObjectHypothesisWithPose:
    result = ObjectHypothesisWithPose()
    result.hypothesis.class_id = PREDICTED_ID
    result.hypothesis.score = float(item.score)
    x, y = (item.position / cell_size_m).tolist()
    _fill_pose(result.pose, x, y, item.cov / cell_size_m**2)
    return result


def array_to_estimates(message: Detection2DArray, cell_size_m: float) -> list[Estimate]:
    """
    Return an array's entries, positions in metres and without velocity.

    An entry without a result gets score 0 and an unknown covariance (NaN).

    Raises
    ------
    Malformed
        If there are more than 10,000 entries.

    """
    count = len(message.detections)
    if count > _MOST_ENTRIES:
        raise Malformed('too many entries', f'{count} entries, at most {_MOST_ENTRIES}')
    if count == 0:
        return []
    states, covs = np.full((count, 4), np.nan), np.full((count, 4, 4), np.nan)
    centres = [item.bbox.center.position for item in message.detections]
    states[:, POS] = np.reshape([(c.x, c.y) for c in centres], (count, 2)) * cell_size_m
    best = [item.results[0] if item.results else _NO_RESULT for item in message.detections]
    stated = [[result.pose.covariance[n] for n in _COV] for result in best]
    rows, cols = np.ix_(POS, POS)
    covs[:, rows, cols] = np.reshape(stated, (count, 2, 2)) * cell_size_m**2
    return [
        Estimate(
            state, cov, result.hypothesis.score, item.id, _prediction(item, cell_size_m))
        for state, cov, result, item in zip(states, covs, best, message.detections)]


def _prediction(item: Detection2D, cell_size_m: float) -> Prediction | None:
    """Return what an entry says that its detector predicted, if it does."""
    if len(item.results) < 2 or item.results[1].hypothesis.class_id != PREDICTED_ID:
        return None
    place, stated = item.results[1].pose.pose.position, item.results[1].pose.covariance
    return Prediction(
        item.results[1].hypothesis.score, np.array([place.x, place.y]) * cell_size_m,
        np.reshape([stated[n] for n in _COV], (2, 2)) * cell_size_m**2)


def array_to_sound_estimates(message: Detection2DArray, cell_size_m: float) -> list[Estimate]:
    """
    Return an array's entries as :func:`array_to_estimates` does, where all can be believed.

    Raises
    ------
    Malformed
        If there are too many, a position is not finite or beyond 1e9 m, or an id is longer than
        255 letters or that of two entries; says which.

    """
    entries = array_to_estimates(message, cell_size_m)
    ids: set[str] = set()
    for item in entries:
        _check(item)
        if item.id and item.id in ids:
            raise Malformed('id of two entries', f'two entries have the id {item.id!r}')
        ids.add(item.id)
    return entries


def _check(item: Estimate) -> None:
    """Raise Malformed where an entry cannot be believed; NaN is a velocity not known."""
    if len(item.id) > _LONGEST_ID:
        raise Malformed(
            'id too long', f'id {item.id[:20]!r}... has {len(item.id)} letters, '
            f'at most {_LONGEST_ID}')
    x, y = item.state[POS].tolist()
    if not (abs(x) <= _FARTHEST and abs(y) <= _FARTHEST):
        raise Malformed('no place', f'entry {item.id!r} is at ({x:g}, {y:g}) m')
    v_x, v_y = item.state[VEL].tolist()
    if abs(v_x) > _FARTHEST or abs(v_y) > _FARTHEST:
        raise Malformed('no velocity', f'entry {item.id!r} moves with ({v_x:g}, {v_y:g}) m/s')


def estimate_to_odometry(item: Estimate, header: Header) -> Odometry:
    """Return one estimate with its velocity and both covariances, metres and m/s."""
    message = Odometry(header=header, child_frame_id=item.id)
    x, v_x, y, v_y = (float(value) for value in item.state)
    _fill_pose(message.pose, x, y, item.cov[np.ix_(POS, POS)])
    message.twist.twist.linear.x, message.twist.twist.linear.y = v_x, v_y
    covariance = np.zeros((6, 6))
    covariance[_XY] = item.cov[np.ix_(VEL, VEL)]
    message.twist.covariance = covariance.ravel()
    return message


def odometry_to_estimate(message: Odometry, score: float) -> Estimate:
    """
    Return an odometry as an estimate; position and velocity are taken as uncorrelated.

    Raises
    ------
    Malformed
        If a position is not finite, a position or velocity beyond 1e9, or the id longer than 255
        letters; says which.  NaN is a velocity that is not known.

    """
    state, cov = np.empty(4), np.zeros((4, 4))
    position, velocity = message.pose.pose.position, message.twist.twist.linear
    state[POS], state[VEL] = (position.x, position.y), (velocity.x, velocity.y)
    cov[np.ix_(POS, POS)] = np.reshape(message.pose.covariance, (6, 6))[_XY]
    cov[np.ix_(VEL, VEL)] = np.reshape(message.twist.covariance, (6, 6))[_XY]
    item = Estimate(state, cov, score, message.child_frame_id)
    _check(item)
    return item


def _fill_pose(pose: PoseWithCovariance, x: float, y: float, cov: np.ndarray) -> None:
    pose.pose.position.x, pose.pose.position.y = x, y
    pose.pose.orientation.w = 1.0
    covariance = np.zeros((6, 6))
    covariance[_XY] = cov
    pose.covariance = covariance.ravel()
