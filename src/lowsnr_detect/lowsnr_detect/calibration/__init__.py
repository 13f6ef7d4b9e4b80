"""
Thresholds for a given false-alarm probability.

:mod:`empty_frames` simulates the statistic of a detector in frames of noise, :mod:`curve`
derives the threshold for every false-alarm probability from it, :mod:`cache` keeps the curves
on disk, and :mod:`operating_point` sets the threshold of a detector.
"""
