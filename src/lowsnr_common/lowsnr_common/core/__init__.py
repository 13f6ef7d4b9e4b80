# SPDX-License-Identifier: Apache-2.0
"""Models of motion and sensor, likelihoods, particles, records and random streams."""
