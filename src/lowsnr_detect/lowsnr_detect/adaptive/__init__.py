"""
Adaptive thresholds: from the earlier frames of the sequence itself.

:mod:`adaptive_detector` runs a detector with them, :mod:`adaptive_threshold` learns them from the
:mod:`local_maxima` of the statistic, by region (:mod:`region_maps`), and :mod:`pareto_tail`
extrapolates their tail.
"""
