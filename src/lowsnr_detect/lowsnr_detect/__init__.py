"""Detectors of weak objects, their registry and their calibration."""
