# SPDX-License-Identifier: Apache-2.0
"""Declared, checked settings: one declaration serves Python, YAML, ROS and validation."""
