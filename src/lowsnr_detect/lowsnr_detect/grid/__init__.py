# SPDX-License-Identifier: Apache-2.0
"""
Bayes filters on a grid of states: what they share.

:mod:`.transitions` holds the probabilities of the steps and predicts; :mod:`.move_classes` and
:mod:`.point_classes` derive these probabilities from the motion model.
"""
