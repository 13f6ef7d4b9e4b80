# SPDX-License-Identifier: Apache-2.0
"""Settings, models of motion and sensor, particles, and the edge to ROS."""
