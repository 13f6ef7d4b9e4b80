# SPDX-License-Identifier: Apache-2.0
"""Messages with any values that their types allow, sound or not."""

import array

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue
from fuzz.strategies import names
from fuzz.strategies import numbers
from fuzz.strategies import whole
from geometry_msgs.msg import PoseWithCovariance
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
import numpy as np
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from vision_msgs.msg import BoundingBox2D
from vision_msgs.msg import Detection2D
from vision_msgs.msg import Detection2DArray
from vision_msgs.msg import ObjectHypothesis
from vision_msgs.msg import ObjectHypothesisWithPose

ENCODINGS = {
    'mono8': 1, '8UC1': 1, 'mono16': 2, '16UC1': 2, '32FC1': 4, '8SC1': 1, '16SC1': 2, '32SC1': 4,
    '64FC1': 8, '32FC3': 12, 'rgb8': 3, 'bgra16': 8, 'bayer_rggb8': 1, 'yuv422': 2, 'jpeg': 1,
    '32fc1': 4, ' 32FC1': 4}
SIZES = [0, 1, 2, 3, 5, 7, 16, 255, 65536, 2**31, 2**32 - 1]
sizes = st.sampled_from(SIZES[1:7]) | st.sampled_from(SIZES) | st.integers(0, 2**32 - 1)
# Values of cells that arithmetic may not survive.
_FLOATS = np.array([0.0, 1e-45, 1e-30, 3.4e38, -3.4e38, np.nan, np.inf, -np.inf], '<f4')


def stamped(stamp_ns: int) -> Header:
    """Return a header with a stamp [ns]."""
    header = Header(frame_id='sensor')
    header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
    return header


@st.composite
def pixels(draw: st.DrawFn, length: int, of_size: int) -> bytes:
    """Return that many bytes: noise, all equal, or numbers of which some are not finite."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    how = draw(st.integers(0, 3))
    if how == 0:
        return rng.bytes(length)
    if how == 1:
        return bytes([draw(st.integers(0, 255))]) * length
    cells = rng.standard_normal(-(-length // 4)).astype('<f4')
    if how == 2 and cells.size:
        cells[rng.integers(cells.size, size=2)] = _FLOATS[
            draw(st.integers(0, len(_FLOATS) - 1))]
    data = cells.tobytes() if of_size == 4 else rng.integers(0, 9, length, np.uint8).tobytes()
    return data[:length]


@st.composite
def images(draw: st.DrawFn) -> Image:
    """Return an image, well-formed in about half of the draws."""
    encoding = draw(st.sampled_from(['32FC1'] * 6 + list(ENCODINGS)) | names.filter(sendable))
    item = ENCODINGS.get(encoding, 4)
    whole = draw(st.booleans())
    rows, cols = (draw(st.integers(1, 16) if whole else sizes) for _ in range(2))
    step = min(cols * item, 2**32 - 1)
    if not whole or draw(st.integers(0, 3)) == 0:
        step = draw(st.sampled_from([0, 1, 2**32 - 1, step, min(step + 3, 2**32 - 1)]))
    length = min(rows * step, 4096)
    if not whole:
        length = max(0, length + draw(st.sampled_from([-length, -4, -1, 0, 0, 1, 4, 64])))
    data = array.array('B')
    data.frombytes(draw(pixels(length, item)))
    return Image(
        height=rows, width=cols, encoding=encoding, step=step, data=data,
        is_bigendian=draw(st.sampled_from([0, 0, 0, 1, 255])))


def sendable(name: str) -> bool:
    """Return whether a message can hold a name unchanged."""
    return '\0' not in name


_covariances = st.lists(numbers, min_size=4, max_size=4) | st.sampled_from([
    [1.0, 0.0, 0.0, 1.0], [0.0] * 4, [-1.0, 0.0, 0.0, -1.0], [1.0, 2.0, 2.0, 1.0], [1e308] * 4])
_ids = st.sampled_from(['', '1', '1', '2', 'object']) | names.filter(sendable)


@st.composite
def covariances(draw: st.DrawFn) -> np.ndarray:
    """Return the 36 numbers of a covariance."""
    full = np.zeros((6, 6))
    full[:2, :2] = np.reshape(draw(_covariances), (2, 2))
    return full.ravel()


@st.composite
def detections(draw: st.DrawFn) -> Detection2D:
    """Return an entry of an array."""
    x, y, score = draw(numbers), draw(numbers), draw(numbers)
    item = Detection2D(id=draw(_ids), bbox=BoundingBox2D(size_x=draw(numbers)))
    item.bbox.center.position.x, item.bbox.center.position.y = x, y
    for kind in (item.id, 'predicted')[:draw(st.sampled_from([1, 1, 0, 2, 2]))]:
        result = ObjectHypothesisWithPose(
            hypothesis=ObjectHypothesis(class_id=kind, score=score),
            pose=PoseWithCovariance(covariance=draw(covariances())))
        result.pose.pose.position.x, result.pose.pose.position.y = x, draw(numbers)
        item.results.append(result)
    return item


@st.composite
def arrays(draw: st.DrawFn) -> Detection2DArray:
    """Return an array of a few entries, or of very many."""
    entries = draw(st.lists(detections(), max_size=5))
    if entries and draw(st.integers(0, 40)) == 0:
        entries = entries * draw(st.sampled_from([100, 2000 // len(entries)]))
    return Detection2DArray(detections=entries)


@st.composite
def odometries(draw: st.DrawFn) -> Odometry:
    """Return the state of an object."""
    item = Odometry(child_frame_id=draw(_ids))
    item.pose.pose.position.x, item.pose.pose.position.y = draw(numbers), draw(numbers)
    item.twist.twist.linear.x, item.twist.twist.linear.y = draw(numbers), draw(numbers)
    item.pose.covariance, item.twist.covariance = draw(covariances()), draw(covariances())
    return item


# Stamps that rise, repeat, fall, are negative, or are the largest there are.
@st.composite
def projections(draw: st.DrawFn) -> CameraInfo:
    """Draw a camera_info: a map of a frame, or some of its numbers."""
    size = st.sampled_from([8, 10, 8, 10, 0, 2**32 - 1])
    info = CameraInfo(width=draw(size), height=draw(size))
    info.binning_x = info.binning_y = draw(st.sampled_from([1, 2, 2, 2, 0, 2**32 - 1]))
    places = st.integers(-9, 9).map(float) | st.floats(-30.0, 30.0) | numbers
    info.k, info.p = np.eye(3).ravel(), np.zeros(12)
    info.k[[2, 5]] = draw(places), draw(places)
    info.p[[2, 6]] = draw(places), draw(places)
    return info


steps_ns = st.sampled_from([1_000_000_000] * 6 + [1, 0, -1, -10**9, 10**12, 2**61])
stamps_ns = st.integers(1, 30).map(lambda k: k * 10**9) | st.sampled_from(
    [0, 1, -1, -10**9, -2**31 * 10**9, 2**31 * 10**9 - 1])


_texts = names.filter(sendable) | numbers.map(str) | st.integers(0, 99).map(str) | (
    whole.filter(lambda value: abs(value) < 10**400).map(str))
_keys = st.sampled_from(['frame', 'detections', 'tracks', 'started_s_ago']) | _texts
# Mostly sound, so that many are read.
_counts = st.integers(0, 7).flatmap(
    lambda which: st.integers(1, 99).map(str) if which else _texts)
_right = st.fixed_dictionaries(dict.fromkeys(('frame', 'detections', 'tracks'), _counts))
_values = st.dictionaries(_keys, _texts, max_size=4) | _right | (
    st.fixed_dictionaries({'started_s_ago': _texts}))


@st.composite
def records(draw: st.DrawFn) -> DiagnosticArray:
    """Return an array of statuses that anybody could publish."""
    message = DiagnosticArray()
    message.header.stamp.sec = draw(st.sampled_from([0, 1, -1, 2**31 - 1, -2**31]))
    message.header.stamp.nanosec = draw(st.sampled_from([0, 10**9 - 1, 10**9, 2**32 - 1]))
    for _ in range(draw(st.integers(0, 3))):
        pairs = [KeyValue(key=key, value=value) for key, value in draw(_values).items()]
        message.status.append(DiagnosticStatus(
            name=draw(_texts | st.just('/evaluator')), values=pairs))
    return message
