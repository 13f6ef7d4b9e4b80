"""Declared, checked settings: one declaration serves Python, YAML, ROS and validation."""
