# SPDX-License-Identifier: Apache-2.0
"""What the tiles find is joined by stamp, and a tile that is away holds nothing up for long."""

from lowsnr_detect.tiles.tile_join import TileJoin
import pytest

WITHIN_S = 5.0


@pytest.fixture
def join():
    """Return a join of two tiles."""
    return TileJoin(2, WITHIN_S)


def taken(join, now_s):
    """Return stamps, and numbers of the tiles, of the frames that are complete."""
    return [(frame.stamp, sorted(frame.parts)) for frame in join.take(now_s)]


def test_frame_waits_for_all_tiles_in_any_order(join):
    assert join.add(1, 10, 'a', 0.0)
    assert taken(join, 0.1) == []
    join.add(1, 20, 'b', 0.2)
    join.add(2, 10, 'c', 0.3)
    first, = join.take(0.3)
    assert (first.stamp, first.parts) == (10, {1: 'a', 2: 'c'})
    join.add(2, 20, 'd', 0.4)
    assert taken(join, 0.4) == [(20, [1, 2])]


def test_tile_that_skips_a_frame_is_not_waited_for(join):
    join.add(1, 10, '', 0.0)
    join.add(2, 20, '', 0.0)
    assert taken(join, 0.0) == [(10, [1])]
    join.add(1, 20, '', 0.0)
    assert taken(join, 0.0) == [(20, [1, 2])]


def test_tile_that_is_away_costs_one_wait_until_it_is_back(join):
    for stamp in (10, 20, 30):
        join.add(1, stamp, '', stamp / 10)
    assert taken(join, 1.0 + WITHIN_S - 0.1) == []
    assert taken(join, 1.0 + WITHIN_S) == [(10, [1]), (20, [1]), (30, [1])]
    join.add(1, 40, '', 9.0)
    assert taken(join, 9.0) == [(40, [1])]
    assert not join.add(2, 40, '', 9.1)  # it is back, too late for this frame
    assert taken(join, 9.1) == []
    join.add(1, 50, '', 9.2)
    assert taken(join, 9.2) == []
    join.add(2, 50, '', 9.3)
    assert taken(join, 9.3) == [(50, [1, 2])]


def test_frames_that_a_tile_lost_when_it_died_wait_no_more(join):
    for stamp in (10, 20):
        join.add(1, stamp, '', 0.0)
    join.pass_by(2)
    assert taken(join, 0.0) == [(10, [1]), (20, [1])]
    join.add(1, 30, '', 0.0)
    assert taken(join, 0.0) == []
    join.add(2, 30, '', 0.0)
    assert taken(join, 0.0) == [(30, [1, 2])]


def test_nothing_comes_of_tiles_that_are_all_away(join):
    assert taken(join, 100.0) == []


def test_stamps_that_come_again_are_answered_again(join):
    for _ in range(3):
        for stamp in range(100):
            join.add(1, stamp, '', 0.0)
            assert taken(join, 0.0) == []
            join.add(2, stamp, '', 0.0)
            assert taken(join, 0.0) == [(stamp, [1, 2])]


@pytest.mark.parametrize('behind', [1, 7, 24])
def test_tile_that_is_behind_when_the_clock_is_set_back_is_waited_for(join, behind):
    found, stamps = [], [*range(50)] * 3
    for step in range(len(stamps) + behind):
        if step < len(stamps):
            join.add(1, stamps[step], '', 0.0)
        if step >= behind:
            join.add(2, stamps[step - behind], '', 0.0)
        found += taken(join, 0.0)
    assert found == [(stamp, [1, 2]) for stamp in stamps]


def test_tile_that_was_away_when_the_clock_was_set_back_joins_the_others(join):
    for stamp in (10, 60):
        join.add(1, stamp, '', 0.0)
        join.add(2, stamp, '', 0.0)
    join.add(1, 70, '', 0.0)
    assert taken(join, WITHIN_S) == [(10, [1, 2]), (60, [1, 2]), (70, [1])]
    join.add(1, 10, '', 6.0)
    assert taken(join, 6.0) == [(10, [1])]
    for stamp in (20, 65):  # before and after the last that it answered
        join.add(1, stamp, '', 7.0)
        join.add(2, stamp, '', 7.0)
        assert taken(join, 7.0) == [(stamp, [1, 2])]


def test_tile_that_was_restarted_when_the_clock_was_set_back_joins_the_others(join):
    for tile in (1, 2):
        join.add(tile, 60, '', 0.0)
    join.add(1, 10, '', 0.0)
    assert taken(join, 0.0) == [(60, [1, 2])]
    join.pass_by(2)
    assert taken(join, 0.0) == [(10, [1])]
    for tile in (1, 2):
        join.add(tile, 20, '', 0.0)
    assert taken(join, 0.0) == [(20, [1, 2])]


def test_wrong_stamp_of_one_tile_costs_that_tile_alone_and_no_frame_twice(join):
    for stamp in (10, 20):
        join.add(1, stamp, '', 0.0)
        join.add(2, stamp, '', 0.0)
    join.add(1, 10**6, '', 0.0)
    assert taken(join, 0.0) == [(10, [1, 2]), (20, [1, 2])]
    join.add(2, 30, '', 0.0)
    assert taken(join, 0.0) == [(30, [2])]
    for stamp in (40, 50):
        for tile in (1, 2):
            join.add(tile, stamp, '', 0.0)
        assert taken(join, 0.0) == [(stamp, [1, 2])]
    assert taken(join, WITHIN_S) == [(10**6, [1])]
    for tile in (2, 1):
        join.add(tile, 60, '', WITHIN_S)
    assert taken(join, WITHIN_S) == [(60, [1, 2])]


def test_clock_of_the_stamps_may_be_set_back(join):
    for stamp in (1000, 10):
        join.add(1, stamp, '', 0.0)
        join.add(2, stamp, '', 0.0)
        assert taken(join, 0.0) == [(stamp, [1, 2])]
