"""Sections III, IV-A and V: detectors, calibration, detector node."""
