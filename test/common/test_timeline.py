# SPDX-License-Identifier: Apache-2.0
"""The order of stamps: new, late, and a clock that was set back."""

import itertools

from lowsnr_common.core.timeline import in_seconds
from lowsnr_common.core.timeline import increasing
from lowsnr_common.core.timeline import SET_BACK_AFTER
from lowsnr_common.core.timeline import SET_BACK_AFTER_S
from lowsnr_common.core.timeline import StampOrder
from lowsnr_common.core.timeline import Timeline
import numpy as np
import pytest

NEW, LATE, SET_BACK = StampOrder.NEW, StampOrder.LATE, StampOrder.SET_BACK
SECOND = 1_000_000_000
YEAR_2100 = 4_102_444_800 * SECOND


def orders(*stamps, timeline=None, every_s=0.0):
    """Return the order of each stamp of a stream, whose messages come at once or at times."""
    timeline = timeline or Timeline()
    return [timeline.classify(stamp, k * every_s) for k, stamp in enumerate(stamps)]


def test_rising_stamps_are_new_from_zero_on_for_any_step():
    assert orders(0, 1, 2, 10 * SECOND, YEAR_2100) == [NEW] * 5


def test_repeated_earlier_and_negative_stamps_are_late():
    assert orders(5, 5, 3, 0, -1, 6) == [NEW, LATE, LATE, LATE, LATE, NEW]


def test_one_stamp_of_the_far_future_loses_nine_messages():
    found = orders(1, 2, YEAR_2100, *range(3, 20))
    late = SET_BACK_AFTER - 1
    assert found == [NEW] * 3 + [LATE] * late + [SET_BACK] + [NEW] * (17 - late - 1)


def test_stream_continues_from_a_clock_that_is_set_back_repeatedly():
    once = [LATE] * (SET_BACK_AFTER - 1) + [SET_BACK] + [NEW] * 5
    timeline = Timeline()
    for _ in range(3):
        timeline.classify(10**12, 0.0)
        assert orders(*range(15), timeline=timeline) == once
        assert timeline.newest == 14


def test_stream_of_seldom_messages_continues_with_the_second_late_one():
    assert orders(1, YEAR_2100, 2, 3, 4, every_s=SET_BACK_AFTER_S) == [
        NEW, NEW, LATE, SET_BACK, NEW]
    assert orders(1, YEAR_2100, 2, 3, 4, 5, every_s=0.5 * SET_BACK_AFTER_S) == [
        NEW, NEW, LATE, LATE, SET_BACK, NEW]
    assert orders(9, 1, 1, 1, 0, -1, every_s=SET_BACK_AFTER_S) == [NEW] + [LATE] * 5


def test_constant_falling_and_negative_stamps_never_set_back():
    for stamps in ([0] * 1000, [7] * 1000, range(1000, 0, -1), range(-1000, 0)):
        assert set(orders(10**6, *stamps)[1:]) == {LATE}


def test_late_messages_between_new_ones_never_set_back():
    stamps = [stamp for k in range(100) for stamp in (1000 + k, k)]
    assert orders(*stamps) == [NEW, LATE] * 100


def test_stream_continues_within_ten_messages_of_any_garbage():
    rng = np.random.default_rng(3)
    for _ in range(200):
        timeline = Timeline()
        garbage = rng.integers(-2**62, 2**62, 50).tolist()
        orders(*garbage, timeline=timeline)
        found = orders(*range(1, 31), timeline=timeline)
        assert LATE not in found[SET_BACK_AFTER - 1:]


@pytest.mark.parametrize('length', range(7))
def test_most_stamps_that_increase_are_found_as_by_trying_all(length):
    for stamps in itertools.islice(itertools.product(range(4), repeat=length), 0, None, 3):
        best = max(
            (len(each) for size in range(length + 1)
             for each in itertools.combinations(range(length), size)
             if all(stamps[a] < stamps[b] for a, b in itertools.pairwise(each))), default=0)
        found = increasing(stamps)
        assert len(found) == best
        kept = [stamps[k] for k in found]
        assert found == sorted(found)
        assert kept == sorted(set(kept))


@pytest.mark.parametrize(('stamp', 'text'), [
    (0, '0.000000000'), (1_700_000_000_123_456_789, '1700000000.123456789'),
    (-1, '-0.000000001'), (-1_500_000_000, '-1.500000000')])
def test_stamps_are_written_in_full(stamp, text):
    assert in_seconds(stamp) == text
