"""Thresholds for a wanted false-alarm probability."""
