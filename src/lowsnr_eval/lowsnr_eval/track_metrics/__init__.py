# SPDX-License-Identifier: Apache-2.0
"""Metrics of tracks over time: OSPA(2), SIAP, identities, calibration of existence."""
