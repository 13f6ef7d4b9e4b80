# SPDX-License-Identifier: Apache-2.0
"""Messages that every node must reject, of every type that nodes subscribe to; from one seed."""

import array

from builtin_interfaces.msg import Time
from lowsnr_common.core.records import Estimate
from lowsnr_common.ros import messages
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray

SHAPE = (20, 20)
_HUGE = (np.nan, np.inf, -np.inf, 1e300, -1e300)
_LONG = 'x' * 2**20


def images(rng):
    """Return images, by what is wrong with them."""
    broken = {
        'encoding rgb8': {'encoding': 'rgb8'}, 'encoding mono8': {'encoding': 'mono8'},
        'no encoding': {'encoding': ''}, 'long encoding': {'encoding': _LONG},
        'short step': {'step': 3}, 'long step': {'step': 2**31},
        'no rows': {'height': 0}, 'no columns': {'width': 0},
        'huge without data': {'height': 16384, 'width': 16384, 'step': 65536},
        'too tall': {'height': 21}, 'no data': {'data': array.array('B')},
        'half the data': {'data': array.array('B', bytes(800))},
        'a megabyte': {'data': array.array('B', rng.bytes(2**20))}}
    found = {what: _image(rng) for what in broken}
    for what, fields in broken.items():
        for field, value in fields.items():
            setattr(found[what], field, value)
    found['random bytes'] = _image(rng)
    found['random bytes'].data = array.array('B', b'\xff' * 4 + rng.bytes(1596))
    for value in (np.nan, np.inf, -np.inf, 3e38, -3e38):
        frame = rng.standard_normal(SHAPE)
        frame[tuple(rng.integers(20, size=2))] = value
        found[f'cell {value}'] = messages.frame_to_image(frame, Header())
    for shape in ((20, 21), (1, 1), (512, 512)):
        found[f'size {shape}'] = messages.frame_to_image(rng.standard_normal(shape), Header())
    return found


def arrays(rng):
    """Return arrays of entries, by what is wrong with them."""
    found = {f'at {value}': _entries((value, 3.0)) for value in _HUGE}
    found |= {f'score {value}': _entries(_place(rng), score=value)
              for value in (*_HUGE, -0.1, 1.1)}
    found |= {f'variance {value}': _entries(_place(rng), variance=value)
              for value in (*_HUGE, 0.0, -1.0)}
    found['no results'] = _entries(_place(rng), _place(rng))
    for entry in found['no results'].detections:
        entry.results = []
    found['one id twice'] = _entries(_place(rng), _place(rng), ids=('a', 'a'))
    found['long id'] = _entries(_place(rng), ids=(_LONG,))
    found['id of nobody'] = _entries(_place(rng), ids=('nobody',))
    found['strange id'] = _entries(_place(rng), ids=('\0\n;"\'<b>\u202e\U0001f600',))
    found['thousands'] = _entries(*rng.uniform(0.0, 19.0, (3000, 2)))
    found['too many'] = _entries(_place(rng))
    found['too many'].detections = found['too many'].detections * 10_001
    found['outside'] = _entries((-40.0, 3.0), (3.0, 4000.0))
    return found


def odometries(rng):
    """Return odometry messages, by what is wrong with them."""
    found = {}
    for value in _HUGE:
        found[f'at {value}'] = _odometry((value, 1.0, 2.0, 3.0))
        found[f'velocity {value}'] = _odometry((1.0, value, 2.0, 3.0))
        found[f'variance {value}'] = _odometry(rng.uniform(size=4), variance=value)
    found['no id'] = _odometry(rng.uniform(size=4), name='')
    found['long id'] = _odometry(rng.uniform(size=4), name=_LONG)
    return found


def stamps(rng):
    """Return stamps that no later frame can have."""
    return [
        Time(), Time(sec=1), Time(sec=-1), Time(sec=-2**31, nanosec=2**32 - 1),
        Time(sec=0, nanosec=2**32 - 1), Time(sec=-int(rng.integers(1, 2**31)))]


def raw(rng, message):
    """Return bytes that are no message of the given one's type, by what is wrong with them."""
    whole = serialize_message(message)
    places = rng.integers(12, len(whole), 4)  # not in the stamp
    flipped = bytearray(whole)
    for place in places:
        flipped[place] ^= 0xff
    return {
        'header alone': whole[:4], 'cut off': whole[:int(places[0])],
        'flipped': bytes(flipped), 'random': whole[:4] + rng.bytes(300),
        'endless lengths': whole[:4] + b'\xff' * 300}


BY_TYPE = {Image: images, Detection2DArray: arrays, Odometry: odometries}


def _image(rng):
    return messages.frame_to_image(rng.standard_normal(SHAPE), Header())


def _place(rng):
    return rng.uniform(0.0, 19.0, 2)


def _entries(*places, score=0.9, variance=0.3, ids=None):
    cov = np.diag([variance] * 4)
    return messages.estimates_to_array(
        [Estimate(np.array([x, 0.0, y, 0.0]), cov, score, name)
         for (x, y), name in zip(places, ids or [''] * len(places))], Header(), 1.0)


def _odometry(state, variance=1.0, name='a'):
    return messages.estimate_to_odometry(
        Estimate(np.array(state), np.diag([variance] * 4), 1.0, name), Header())
