# SPDX-License-Identifier: Apache-2.0
"""The ROS side of a run: manager, supervisor and cameras."""
