# SPDX-License-Identifier: Apache-2.0
"""Quality of service of every topic."""

from __future__ import annotations

from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy

_FRAME_BYTES = 256 * 2**20


def reliable(depth: int) -> QoSProfile:
    """Return the QoS of everything small: reliable, the last ``depth`` kept."""
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE)


def frame_depth(depth: int, rows: int, cols: int) -> int:
    """Return how many frames are kept: ``depth``, or what 256 MiB hold of large ones."""
    return max(2, min(depth, _FRAME_BYTES // max(1, 4 * rows * cols)))


def any_reliability(depth: int) -> QoSProfile:
    """Return the QoS of a frame reader, which has the reliability of the publisher."""
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_AVAILABLE)
