# SPDX-License-Identifier: Apache-2.0
"""Figures of what is traded for what show the points that they are given."""

from lowsnr_eval.report.trade_offs import detection_against_false_alarms
from lowsnr_eval.report.trade_offs import detection_against_snr
import numpy as np


def drawn(axes, label):
    """Return x and y of the points with a label, and the ends of their bars."""
    found, = [each for each in axes.containers if each.get_label() == label]
    bars = [np.array(each.get_segments())[..., n] for n, each in enumerate(found[2])]
    return found[0].get_xydata().tolist(), bars


def test_snr_of_zero_and_below_is_drawn():
    points = [(-3.0, 0.1, 0.05, 0.2), (0.0, 0.4, 0.3, 0.5), (3.0, 0.9, 0.8, 1.0)]
    axes, = detection_against_snr({'matched': {'sdt': points}}, {}).axes
    found, (_, of_y) = drawn(axes, 'sdt')
    assert found == [[-3.0, 0.1], [0.0, 0.4], [3.0, 0.9]]
    np.testing.assert_allclose(of_y, [each[2:] for each in points])


def test_false_alarm_rate_of_zero_is_left_out_and_a_bound_of_zero_is_drawn():
    points = [(0.0, 0.0, 0.01, 0.1, 0.05, 0.2), (0.01, 0.0, 0.03, 0.9, 0.8, 1.0)]
    panels = {'9 dB': {'sdt': (points, []), 'cdt': ([], points)}}
    axes, = detection_against_false_alarms(panels, [], {}).axes
    found, (of_x, _) = drawn(axes, 'sdt')
    assert found == [[0.01, 0.9]]
    np.testing.assert_allclose(of_x, [[1e-5, 0.03]])
