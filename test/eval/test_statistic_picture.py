# SPDX-License-Identifier: Apache-2.0
"""The statistic of a detector as a picture: its levels, and what a live page is sent."""

import base64
import json

from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.records import AlarmRate
from lowsnr_eval.live.live_page import frame_text
from lowsnr_eval.live.live_page import statistic_picture
from lowsnr_eval.report.palette import excess_range
from lowsnr_eval.report.palette import to_levels
import numpy as np
import pytest

SHAPE = (7, 5)


def test_levels_of_a_statistic_tell_both_sides_of_its_threshold_apart():
    excess = np.array([-np.inf, -30.0, -20.0, -1e-6, 0.0, 1e-6, 5.0, 50.0, np.nan])
    levels = to_levels(excess, (-20.0, 10.0))
    assert levels.tolist() == [1, 1, 1, 126, 127, 128, 191, 255, 0]
    low, high = excess_range(np.array([-np.inf, *np.linspace(-20.0, 4.0, 101), np.nan]))
    assert low == pytest.approx(-20.0 + 0.01 * 24.0)
    assert high == 4.0
    assert excess_range(np.array([np.nan, -np.inf])) == (-1.0, 1.0)


def test_statistic_is_sent_with_its_place_and_the_limits_of_its_levels():
    """Cells of 2 x 2 pixels, the first of them 8 pixels right in the image and 3 down."""
    excess = np.full((3, 2), -2.0)
    excess[1, 1], excess[0, 0] = 4.0, -np.inf
    where = FrameMap('camera', (5, 7), 2, (4, -1), (0.0, 5.0))
    sent = statistic_picture(excess, where)
    assert (sent['corner'], sent['side'], sent['shape']) == ([7.5, 2.5], 2, (3, 2))
    assert sent['limits'] == (pytest.approx(-2.0), 4.0)
    assert base64.b64decode(sent['levels']) == bytes([1, 1, 1, 255, 1, 1])
    chain, = json.loads(frame_text(
        1.0, np.zeros(SHAPE, np.uint8), (0.0, 1.0), (None, [], []), AlarmRate(), 1.0, sent,
    ))['chains'].values()
    assert chain['statistic']['levels'] == sent['levels']
