# SPDX-License-Identifier: Apache-2.0
"""Scores of single frames, and the figures of a run, against values worked out by hand."""

import json
import tracemalloc

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Truth
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_eval.scoring.frame_scoring import Answer
from lowsnr_eval.scoring.frame_scoring import compare
from lowsnr_eval.scoring.frame_scoring import score_frame
from lowsnr_eval.scoring.tallies import StreamQuantiles
from lowsnr_eval.scoring.tallies import Tallies
import numpy as np
import pytest

NAN = float('nan')
FIGURES = {
    'pd', 'pfa_per_frame', 'first_detection_latency_frames', 'rmse_position_m',
    'rmse_velocity_mps', 'gospa_m'}


def truth(name, x, y, vx=0.0, vy=0.0):
    return Truth(name, np.array([x, vx, y, vy]))


def estimate(x, y, vx=NAN, vy=NAN):
    return Estimate(np.array([x, vx, y, vy]), np.eye(4), 0.9)


def test_estimate_within_the_gate_is_a_hit_with_its_errors():
    found = compare(
        [truth('a', 3.0, 5.0, 1.0, 0.0)], [estimate(4.0, 6.0, 1.0, 2.0)], Evaluation())
    assert found.hit_ids == ('a',)
    assert found.false_alarms == 0
    assert found.rmse_position_m == pytest.approx(np.sqrt(2))
    assert found.rmse_velocity_mps == pytest.approx(2.0)
    assert found.gospa_m == pytest.approx(np.sqrt(2))


def test_hit_without_velocity_has_no_velocity_error():
    found = compare([truth('a', 3.0, 5.0)], [estimate(3.0, 5.0)], Evaluation())
    assert found.rmse_position_m == 0.0
    assert found.rmse_velocity_mps is None


def test_second_estimate_of_an_object_is_neither_hit_nor_false_alarm():
    found = compare(
        [truth('a', 3.0, 5.0)], [estimate(3.0, 6.0), estimate(3.0, 5.5)], Evaluation())
    assert (found.declared, found.hit_ids, found.false_alarms) == (2, ('a',), 0)
    assert found.rmse_position_m == pytest.approx(0.5)


def test_one_estimate_between_two_objects_hits_one():
    objects = [truth('a', 3.0, 5.0), truth('b', 5.0, 5.0)]
    assert compare(objects, [estimate(4.2, 5.0)], Evaluation()).hit_ids == ('b',)
    both = compare(objects, [estimate(4.2, 5.0), estimate(6.0, 5.0)], Evaluation())
    assert both.hit_ids == ('a', 'b')


def test_estimate_far_from_every_object_is_a_false_alarm():
    found = compare([truth('a', 3.0, 5.0)], [estimate(3.0, 9.0)], Evaluation())
    assert (found.hit_ids, found.false_alarms) == ((), 1)
    assert found.rmse_position_m is None


def test_gate_and_cutoff_are_in_cells():
    evaluation = Evaluation(sensor=SensorModel(cell_size_m=0.1))
    objects = [truth('a', 0.3, 0.5)]
    assert compare(objects, [estimate(0.3, 0.64)], evaluation).hit_ids == ('a',)
    missed = compare(objects, [estimate(0.3, 0.66)], evaluation)
    assert missed.hit_ids == ()
    assert missed.gospa_m == pytest.approx(0.16)
    assert compare(objects, [], evaluation).gospa_m == pytest.approx(0.5 / np.sqrt(2))


def test_nothing_there_and_nothing_declared_is_perfect():
    found = compare([], [], Evaluation())
    assert (found.declared, found.hit_ids, found.false_alarms) == (0, (), 0)
    assert found.gospa_m == 0.0


def test_estimate_without_position_is_a_false_alarm():
    found = compare([truth('a', 3.0, 5.0)], [estimate(NAN, NAN)], Evaluation())
    assert (found.hit_ids, found.false_alarms) == ((), 1)


def add(tallies, frame, objects, answers):
    """Score a frame and count it."""
    tallies.add(score_frame(frame, float(frame), objects, answers, Evaluation()))


@pytest.fixture
def run():
    """
    Return the tallies of six frames of one chain.

    The object is present in frames 2 to 5; frame 4 is not answered by the detector.
    """
    tallies = Tallies(['sdt'])
    near = estimate(3.0, 5.6, 1.0, 0.3)
    frames = [
        ([], [estimate(9.0, 9.0)], []),
        ([truth('a', 3.0, 5.0, 1.0)], [], []),
        ([truth('a', 3.0, 5.0, 1.0)], [estimate(3.0, 6.0), estimate(9.0, 9.0)], [near]),
        ([truth('a', 3.0, 5.0, 1.0)], None, [near]),
        ([truth('a', 3.0, 5.0, 1.0)], [estimate(3.0, 5.0)], []),
        ([], [], []),
    ]
    for frame, (objects, detections, tracks) in enumerate(frames, start=1):
        answer = Answer(detections, tracks)
        add(tallies, frame, objects, {'sdt': answer})
        tallies.add_latency('sdt', float(frame), 0.1 * frame)
    return tallies


def test_figures_of_a_run_are_those_worked_out_by_hand(run):
    figures = run.figures()['sdt']['detection']
    expected = {
        'pd': 2 / 3, 'pfa_per_frame': 1 / 2, 'first_detection_latency_frames': 1.0,
        'rmse_position_m': np.sqrt(1 / 2), 'rmse_velocity_mps': None,
        # Squares of the five answered frames: false, missed, 1 and false, 0, nothing.
        'gospa_m': np.sqrt((12.5 + 12.5 + 13.5 + 0.0 + 0.0) / 5),
        'unanswered': 1, 'frames_with_object': 3, 'frames_without_object': 2,
        'objects_present': 3, 'hits': 2, 'frames_false': 1, 'false_alarms': 2,
        'appearances': 1, 'appearances_hit': 1, 'hits_with_velocity': 0,
    }
    assert {key: figures[key] for key in expected} == pytest.approx(expected)
    # Wilson's score interval for 2 of 3 and for 1 of 2.
    assert figures['pd_interval'] == pytest.approx((0.2077, 0.9385), abs=1e-4)
    assert figures['pfa_interval'] == pytest.approx((0.0945, 0.9055), abs=1e-4)


def test_tracks_are_scored_by_themselves(run):
    figures = run.figures()['sdt']['tracking']
    assert figures['pd'] == pytest.approx(2 / 4)
    assert figures['pfa_per_frame'] == 0.0
    assert figures['rmse_position_m'] == pytest.approx(0.6)
    assert figures['rmse_velocity_mps'] == pytest.approx(0.3)
    assert figures['hits_with_velocity'] == 2


def test_latency_has_median_and_99_per_cent(run):
    assert run.figures()['sdt']['latency_ms'] == pytest.approx({'median': 3.5, 'p99': 5.95})
    assert run.figures()['sdt']['detection_latency_ms'] == pytest.approx(
        {'median': 0.35, 'p99': 0.595})


def test_quantiles_of_a_long_run_are_right_in_bounded_memory(rng):
    values, quantiles = rng.permutation(np.arange(60_000.0)), StreamQuantiles()
    for value in values[:20_000]:
        quantiles.add(value)
    tracemalloc.start()
    for value in values[20_000:]:
        quantiles.add(value)
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    found = quantiles.figures()
    assert held < 100_000
    # Five standard errors of 5,000 values: 3.5 % and 0.7 % of the ranks.
    assert found['median'] == pytest.approx(30_000.0, abs=2100.0)
    assert found['p99'] == pytest.approx(59_400.0, abs=420.0)


def test_frames_that_any_chain_leaves_unanswered_are_counted_once():
    tallies = Tallies(['cdt', 'sdt'])
    whole = Answer([], [])
    add(tallies, 1, [], {'cdt': whole, 'sdt': whole})
    add(tallies, 2, [], {'cdt': whole, 'sdt': Answer([], None)})
    add(tallies, 3, [], {'cdt': whole, 'sdt': Answer()})
    add(tallies, 4, [], {'cdt': Answer(), 'sdt': Answer()})
    assert (tallies.frames, tallies.unanswered) == (4, 3)
    figures = tallies.figures()
    assert figures['cdt']['detection']['unanswered'] == 1
    assert figures['sdt']['detection']['unanswered'] == 2
    assert figures['sdt']['tracking']['unanswered'] == 3


def test_scores_of_a_frame_come_in_order_of_chains_and_levels():
    scores = score_frame(
        7, 3.5, [truth('a', 1.0, 1.0)], {'sdt': Answer([], None), 'cdt': Answer()}, Evaluation())
    assert [(score.detector, score.level) for score in scores] == [
        ('sdt', 'detection'), ('sdt', 'tracking'), ('cdt', 'detection'), ('cdt', 'tracking')]
    assert [score.comparison is None for score in scores] == [False, True, True, True]
    assert {(score.frame, score.stamp_s, score.object_ids) for score in scores} == {
        (7, 3.5, ('a',))}


def test_object_that_comes_back_must_be_found_again():
    tallies = Tallies(['sdt'])
    here, hit = [truth('a', 1.0, 1.0)], Answer([estimate(1.0, 1.0)], [])
    answers = [(here, hit), ([], hit), (here, Answer([], [])), (here, Answer([], [])),
               (here, hit), ([], hit), (here, Answer([], []))]
    for frame, (objects, answer) in enumerate(answers, start=1):
        add(tallies, frame, objects, {'sdt': answer})
    figures = tallies.figures()['sdt']['detection']
    assert (figures['appearances'], figures['appearances_hit']) == (3, 2)
    assert figures['first_detection_latency_frames'] == pytest.approx((0 + 2) / 2)


def test_detection_probability_of_several_objects_counts_each():
    tallies = Tallies(['sdt'])
    objects = [truth('a', 1.0, 1.0), truth('b', 9.0, 9.0), truth('c', 9.0, 1.0)]
    add(tallies, 1, objects, {'sdt': Answer([estimate(9.0, 9.5)], [])})
    figures = tallies.figures()['sdt']['detection']
    assert figures['pd'] == pytest.approx(1 / 3)
    assert (figures['frames_with_object'], figures['objects_present']) == (1, 3)


def test_figures_that_do_not_exist_are_null():
    figures = Tallies(['sdt']).figures()
    assert set(figures['sdt']) == {
        'detection', 'tracking', 'latency_ms', 'detection_latency_ms'}
    for level in ('detection', 'tracking'):
        assert {figures['sdt'][level][key] for key in FIGURES} == {None}
    assert figures['sdt']['latency_ms'] == {'median': None, 'p99': None}
    json.dumps(figures, allow_nan=False)


def test_run_without_objects_has_false_alarms_only():
    tallies = Tallies(['sdt'])
    for frame in range(1, 5):
        declared = [estimate(2.0, 2.0), estimate(5.0, 2.0)] if frame == 2 else []
        add(tallies, frame, [], {'sdt': Answer(declared, [])})
    figures = tallies.figures()['sdt']['detection']
    assert figures['pfa_per_frame'] == 0.25
    assert (figures['frames_false'], figures['false_alarms']) == (1, 2)
    assert {key for key in FIGURES if figures[key] is None} == FIGURES - {
        'pfa_per_frame', 'gospa_m'}


@pytest.mark.parametrize('values', [{'gate_cells': 0.0}, {'gospa_cutoff_cells': -1.0}])
def test_settings_out_of_bounds_are_rejected(values):
    with pytest.raises(ValueError, match=next(iter(values))):
        Evaluation(**values)
