# SPDX-License-Identifier: Apache-2.0
"""Sections III, IV-A and V: detectors, calibration, detector node."""
