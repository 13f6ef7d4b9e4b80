# SPDX-License-Identifier: Apache-2.0
"""Images as cameras send them, without ROS: encodings and compression."""
