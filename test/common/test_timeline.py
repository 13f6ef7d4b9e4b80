"""Late stamps are told from new ones, and a clock set back ends no stream."""

from lowsnr_common.core.timeline import SET_BACK_AFTER
from lowsnr_common.core.timeline import Timeline
from lowsnr_common.core.timeline import Verdict
import numpy as np

NEW, LATE, SET_BACK = Verdict.NEW, Verdict.LATE, Verdict.SET_BACK
SECOND = 1_000_000_000
YEAR_2100 = 4_102_444_800 * SECOND


def judged(*stamps, timeline=None):
    """Return what a stream's stamps are taken for."""
    timeline = timeline or Timeline()
    return [timeline.judge(stamp) for stamp in stamps]


def test_rising_stamps_are_new_from_zero_on_whatever_the_step():
    assert judged(0, 1, 2, 10 * SECOND, YEAR_2100) == [NEW] * 5


def test_repeated_earlier_and_negative_stamps_are_late():
    assert judged(5, 5, 3, 0, -1, 6) == [NEW, LATE, LATE, LATE, LATE, NEW]


def test_one_stamp_of_a_far_future_costs_nine_messages():
    said = judged(1, 2, YEAR_2100, *range(3, 20))
    late = SET_BACK_AFTER - 1
    assert said == [NEW] * 3 + [LATE] * late + [SET_BACK] + [NEW] * (17 - late - 1)


def test_stream_goes_on_where_its_clock_was_set_back_to_and_may_be_again():
    once = [LATE] * (SET_BACK_AFTER - 1) + [SET_BACK] + [NEW] * 5
    timeline = Timeline()
    for _ in range(3):
        timeline.judge(10**12)
        assert judged(*range(15), timeline=timeline) == once
        assert timeline.newest == 14


def test_a_stamp_that_stands_still_falls_or_is_negative_never_sets_back():
    for stamps in ([0] * 1000, [7] * 1000, range(1000, 0, -1), range(-1000, 0)):
        assert set(judged(10**6, *stamps)[1:]) == {LATE}


def test_late_messages_between_new_ones_never_set_back():
    stamps = [stamp for k in range(100) for stamp in (1000 + k, k)]
    assert judged(*stamps) == [NEW, LATE] * 100


def test_any_stream_of_garbage_is_followed_again_within_ten_messages():
    rng = np.random.default_rng(3)
    for _ in range(200):
        timeline = Timeline()
        garbage = rng.integers(-2**62, 2**62, 50).tolist()
        judged(*garbage, timeline=timeline)
        said = judged(*range(1, 31), timeline=timeline)
        assert LATE not in said[SET_BACK_AFTER - 1:]
