# SPDX-License-Identifier: Apache-2.0
"""A small ``ros2`` command, for environments that no installed ROS 2 gives one."""
