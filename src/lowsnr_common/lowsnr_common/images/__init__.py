# SPDX-License-Identifier: Apache-2.0
"""Images without ROS: encodings and compression of cameras, and bands of rows for threads."""
