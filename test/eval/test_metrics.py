# SPDX-License-Identifier: Apache-2.0
"""Metrics against brute force over all assignments, and against SciPy's own interval."""

import itertools

from hypothesis import given
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from lowsnr_eval.scoring.metrics import count_false_alarms
from lowsnr_eval.scoring.metrics import distances
from lowsnr_eval.scoring.metrics import gospa
from lowsnr_eval.scoring.metrics import match_nearest
from lowsnr_eval.scoring.metrics import match_within_gate
from lowsnr_eval.scoring.metrics import ratio
from lowsnr_eval.scoring.metrics import root_mean_square
from lowsnr_eval.scoring.metrics import RootMeanSquare
from lowsnr_eval.scoring.metrics import wilson_interval
import numpy as np
import pytest
from scipy.stats import binomtest

FIXED = settings(deadline=None, derandomize=True)
POINTS = st.integers(0, 4).flatmap(
    lambda n: arrays(float, (n, 2), elements=st.floats(0, 10, width=16)))


def pairings(rows, columns):
    """Yield every set of pairs that uses each row and each column at most once."""
    for count in range(min(rows, columns) + 1):
        for chosen in itertools.combinations(range(rows), count):
            for partners in itertools.permutations(range(columns), count):
                yield list(zip(chosen, partners))


def test_distances_are_between_objects_and_estimates():
    found = distances(np.array([[0.0, 0.0], [3.0, 0.0]]), np.array([[3.0, 4.0]]))
    np.testing.assert_array_equal(found, [[5.0], [4.0]])
    assert distances(np.empty((0, 2)), np.ones((3, 2))).shape == (0, 3)


def test_unknown_position_is_infinitely_far():
    distance = distances(np.zeros((1, 2)), np.array([[np.nan, 0.0], [0.0, 1.0]]))
    np.testing.assert_array_equal(distance, [[np.inf, 1.0]])
    assert match_within_gate(distance, 1.5)[1].tolist() == [1]
    assert count_false_alarms(distance, 1.5) == 1
    assert gospa(distance, 5.0) == pytest.approx(np.sqrt(1.0 + 25.0 / 2))


@pytest.mark.parametrize(('offset', 'hits'), [(0.0, 1), (1.5, 1), (1.5001, 0)])
def test_gate_is_inclusive(offset, hits):
    distance = distances(np.zeros((1, 2)), np.array([[0.0, offset]]))
    assert len(match_within_gate(distance, 1.5)[0]) == hits
    assert count_false_alarms(distance, 1.5) == 1 - hits


@FIXED
@given(POINTS, POINTS, st.floats(0.1, 8.0))
def test_match_is_the_largest_and_among_those_the_nearest(objects, estimates, gate):
    distance = distances(objects, estimates)
    rows, columns = match_within_gate(distance, gate)
    assert np.all(distance[rows, columns] <= gate)
    assert len(set(rows)) == len(rows)
    assert len(set(columns)) == len(columns)
    allowed = [pairs for pairs in pairings(*distance.shape)
               if all(distance[pair] <= gate for pair in pairs)]
    best = min((-len(pairs), sum(distance[pair] for pair in pairs)) for pairs in allowed)
    assert len(rows) == -best[0]
    assert distance[rows, columns].sum() == pytest.approx(best[1])


@FIXED
@given(POINTS, POINTS, st.floats(0.1, 8.0))
def test_false_alarms_are_outside_every_gate(objects, estimates, gate):
    expected = sum(
        all(np.hypot(*(estimate - item)) > gate for item in objects) for estimate in estimates)
    assert count_false_alarms(distances(objects, estimates), gate) == expected


@FIXED
@given(POINTS, POINTS, st.floats(0.1, 12.0), st.sampled_from([1.0, 2.0, 3.0]))
def test_gospa_is_its_definition(objects, estimates, cutoff, order):
    distance = distances(objects, estimates)
    unpaired = cutoff**order / 2.0
    expected = min(
        sum(distance[pair] ** order for pair in pairs)
        + unpaired * (len(objects) + len(estimates) - 2 * len(pairs))
        for pairs in pairings(*distance.shape))
    assert gospa(distance, cutoff, order) == pytest.approx(expected ** (1 / order))


@FIXED
@given(POINTS, POINTS, POINTS)
def test_gospa_is_a_metric(one, two, three):
    def between(left, right):
        return gospa(distances(left, right), 5.0)

    assert between(one, one) == 0.0
    assert between(one, two) == pytest.approx(between(two, one))
    assert between(one, three) <= between(one, two) + between(two, three) + 1e-9


@pytest.mark.parametrize(('objects', 'estimates', 'expected'), [
    ([], [], 0.0),
    ([[1.0, 1.0]], [], 5.0 / np.sqrt(2)),
    ([], [[1.0, 1.0], [2.0, 2.0]], 5.0),
    ([[0.0, 0.0]], [[3.0, 4.0]], 5.0),
    ([[0.0, 0.0]], [[0.0, 1.0]], 1.0),
    ([[0.0, 0.0]], [[0.0, 1.0], [9.0, 9.0]], np.sqrt(1.0 + 12.5)),
])
def test_gospa_of_simple_cases(objects, estimates, expected):
    distance = distances(np.reshape(objects, (-1, 2)), np.reshape(estimates, (-1, 2)))
    assert gospa(distance, 5.0) == pytest.approx(expected)


@pytest.mark.parametrize('confidence', [0.8, 0.95, 0.99])
@pytest.mark.parametrize('trials', [1, 9, 31, 500, 10_000])
def test_wilson_interval_is_scipy_s(trials, confidence):
    for successes in {0, 1, trials // 3, trials - 1, trials}:
        expected = binomtest(successes, trials).proportion_ci(confidence, method='wilson')
        low, high = wilson_interval(successes, trials, confidence)
        assert low == pytest.approx(expected.low, abs=1e-12)
        assert high == pytest.approx(expected.high, abs=1e-12)
        assert 0.0 <= low <= successes / trials <= high <= 1.0


def test_wilson_interval_covers_as_often_as_it_says(rng):
    probability, trials, runs = 0.3, 200, 4_000
    intervals = [wilson_interval(int(n), trials) for n in rng.binomial(trials, probability, runs)]
    covered = np.mean([low <= probability <= high for low, high in intervals])
    # 4 sigma of the runs, and half a per cent because counts are whole.
    assert abs(covered - 0.95) < 4 * np.sqrt(0.95 * 0.05 / runs) + 0.005


def test_figures_of_nothing_do_not_exist():
    assert wilson_interval(0, 0) is None
    assert ratio(0, 0) is None
    assert root_mean_square(np.empty(0)) is None
    assert RootMeanSquare().value is None


def test_root_mean_square_adds_up_group_by_group(rng):
    errors, parts = rng.standard_normal(50), RootMeanSquare()
    for piece in np.split(errors, [3, 3, 20]):
        parts.add(root_mean_square(piece), len(piece))
    expected = np.sqrt(np.mean(errors**2))
    assert parts.value == pytest.approx(expected)
    assert parts.count == 50
    assert root_mean_square(errors) == pytest.approx(expected)


def test_nearest_pairs_are_nearest_to_each_other(rng):
    for n, m in itertools.product(range(4), repeat=2):
        distance = distances(rng.uniform(0, 4, (n, 2)), rng.uniform(0, 4, (m, 2)))
        pairs = [*zip(*match_nearest(distance, 2.0), strict=True)]
        assert pairs == [
            (row, column) for row, column in itertools.product(range(n), range(m))
            if distance[row, column] == min([*distance[row], *distance[:, column], 2.0])]
