# SPDX-License-Identifier: Apache-2.0
"""
Adaptive thresholds: from the frames of the sequence itself.

:mod:`adaptive_detector` runs a detector with them, :mod:`adaptive_threshold` learns them from the
:mod:`local_maxima` of the statistic, by region (:mod:`region_maps`), and :mod:`tail_fit` shrinks
what was learned to the :mod:`white_tail`, which :mod:`known_tails` finds or simulates.
"""
