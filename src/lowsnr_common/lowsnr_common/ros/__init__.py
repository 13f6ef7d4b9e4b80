# SPDX-License-Identifier: Apache-2.0
"""The one edge to ROS: the managed node, its parameters, messages, QoS and diagnostics."""
