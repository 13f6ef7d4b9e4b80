# SPDX-License-Identifier: Apache-2.0
"""Smoothed paths of the tracks of a run, from its tables."""
