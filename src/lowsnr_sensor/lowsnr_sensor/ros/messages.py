"""Frames and records to messages and back: the one place that knows both."""

from __future__ import annotations

import array
from collections.abc import Iterable
import sys

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovariance
from lowsnr_sensor.motion import POS
from lowsnr_sensor.motion import VEL
from lowsnr_sensor.records import Estimate
from lowsnr_sensor.ros.images import image_to_array
from nav_msgs.msg import Odometry
import numpy as np
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2D
from vision_msgs.msg import Detection2DArray
from vision_msgs.msg import ObjectHypothesisWithPose

ENCODING = '32FC1'
CLASS_ID = 'object'
# Places of x and y in the row-major 6 x 6 covariance of a pose or twist.
_XY = np.ix_([0, 1], [0, 1])
# What an entry without a result is taken to say: nothing.
_NO_RESULT = ObjectHypothesisWithPose()
_NO_RESULT.pose.covariance = np.full(36, np.nan)


def stamp_from_seconds(seconds: float) -> Time:
    """Return a time in seconds as a stamp, to the nanosecond."""
    total = round(seconds * 1e9)
    return Time(sec=total // 1_000_000_000, nanosec=total % 1_000_000_000)


def stamp_key(stamp: Time) -> int:
    """Return a stamp as whole nanoseconds, for comparison and as a dictionary key."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def frame_to_image(frame: np.ndarray, header: Header) -> Image:
    """Return a (rows, cols) frame as a 32FC1 image in this machine's byte order."""
    data = array.array('B')
    data.frombytes(np.ascontiguousarray(frame, dtype=np.float32).data.cast('B'))
    return Image(
        header=header, height=frame.shape[0], width=frame.shape[1], encoding=ENCODING,
        is_bigendian=int(sys.byteorder == 'big'), step=4 * frame.shape[1], data=data)


def image_to_frame(image: Image) -> np.ndarray:
    """
    Return a 32FC1 image as a frame.

    Returns
    -------
    (rows, cols) ndarray of float64
        Cell intensities.

    Raises
    ------
    ValueError
        If encoding, step or size do not fit, or a value is not finite; says which.

    """
    if image.encoding != ENCODING:
        raise ValueError(f'encoding is {image.encoding!r}, must be {ENCODING!r}')
    return image_to_array(image).astype(float)


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
    message.bbox.center.position.x, message.bbox.center.position.y = x, y
    message.bbox.size_x = message.bbox.size_y = 1.0
    return message


def array_to_estimates(message: Detection2DArray, cell_size_m: float) -> list[Estimate]:
    """
    Return an array's entries, positions in metres and without velocity.

    An entry without a result gets score 0 and an unknown covariance (NaN).
    """
    count = len(message.detections)
    if count == 0:
        return []
    states, covs = np.full((count, 4), np.nan), np.full((count, 4, 4), np.nan)
    centres = [item.bbox.center.position for item in message.detections]
    states[:, POS] = np.reshape([(c.x, c.y) for c in centres], (count, 2)) * cell_size_m
    best = [item.results[0] if item.results else _NO_RESULT for item in message.detections]
    stated = [[result.pose.covariance[n] for n in (0, 1, 6, 7)] for result in best]
    rows, cols = np.ix_(POS, POS)
    covs[:, rows, cols] = np.reshape(stated, (count, 2, 2)) * cell_size_m**2
    return [
        Estimate(state, cov, result.hypothesis.score, item.id)
        for state, cov, result, item in zip(states, covs, best, message.detections)]


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
    """Return an odometry as an estimate; position and velocity are taken as uncorrelated."""
    state, cov = np.empty(4), np.zeros((4, 4))
    position, velocity = message.pose.pose.position, message.twist.twist.linear
    state[POS], state[VEL] = (position.x, position.y), (velocity.x, velocity.y)
    cov[np.ix_(POS, POS)] = np.reshape(message.pose.covariance, (6, 6))[_XY]
    cov[np.ix_(VEL, VEL)] = np.reshape(message.twist.covariance, (6, 6))[_XY]
    return Estimate(state, cov, score, message.child_frame_id)


def _fill_pose(pose: PoseWithCovariance, x: float, y: float, cov: np.ndarray) -> None:
    pose.pose.position.x, pose.pose.position.y = x, y
    pose.pose.orientation.w = 1.0
    covariance = np.zeros((6, 6))
    covariance[_XY] = cov
    pose.covariance = covariance.ravel()
