# SPDX-License-Identifier: Apache-2.0
"""
Thresholds for a given false-alarm probability.

:mod:`empty_frames` simulates the statistic of a detector in frames of noise, :mod:`curve`
derives the threshold for every false-alarm probability from it, :mod:`cache` keeps the curves
on disk, :mod:`shipped` holds those of the shipped scenarios, and :mod:`operating_point` sets the
threshold of a detector.
"""
