# SPDX-License-Identifier: Apache-2.0
"""Joint decision and estimation against the risk itself, summed over all places."""

from dataclasses import dataclass
from dataclasses import field

from detect import contract
from detect.contract import EVERYTHING
from lowsnr_detect.decisions.decision import Decision
from lowsnr_detect.decisions.decision import gain_tables
from lowsnr_detect.detectors.bernoulli import Bernoulli
from lowsnr_detect.detectors.hmm import HMM
from lowsnr_detect.detectors.pmf import PMF
from lowsnr_detect.detectors.tbd1 import MMTBD1
from lowsnr_detect.detectors.tbd2 import MMTBD2
from lowsnr_eval.scoring.metrics import distances
from lowsnr_eval.scoring.metrics import gospa
import numpy as np
import pytest

RULES = ('gospa', 'hit')
ROWS, COLS = 3, 4
DETECTORS = {'hmm': HMM, 'pmf': PMF, 'bernoulli': Bernoulli, 'mmtbd1': MMTBD1, 'mmtbd2': MMTBD2}


def worth(rule, away, cutoff):
    """Return k(d)."""
    if rule == 'hit':
        return (away <= cutoff).astype(float)
    return np.maximum(1.0 - (away / cutoff)**2, 0.0)


def gains(rule, mass, resolution, cutoff, places):
    """Return G at places (n, 2) in cells, by summing over 12 x 12 parts of every point."""
    parts = 12
    inner = (np.arange(parts) + 0.5) / parts - 0.5
    row, col = (
        ((np.arange(size)[:, None] + inner).ravel() + 0.5) / resolution - 0.5
        for size in mass.shape)
    fine = mass.repeat(parts, 0).repeat(parts, 1) / parts**2
    return np.array([
        np.sum(fine * worth(rule, np.hypot(row[:, None] - y, col - x), cutoff))
        for y, x in places])


def grid_of_places(step):
    return np.array([
        (y, x) for y in np.arange(-0.5, ROWS - 0.5 + 1e-9, step)
        for x in np.arange(-0.5, COLS - 0.5 + 1e-9, step)])


@pytest.mark.parametrize('resolution', [1, 2, 4])
@pytest.mark.parametrize('rule', RULES)
def test_best_place_has_the_least_risk_of_all_places(rng, rule, resolution):
    decision = Decision(rule=rule, cutoff_cells=1.3)
    mass = rng.random((3, ROWS * resolution, COLS * resolution))**6
    mass /= mass.sum(axis=(1, 2), keepdims=True)
    places, share = decision.best_places(7.0 * mass, resolution)
    # A place is at most 1/8 cell from the best one on each axis.
    for one, place, gain in zip(mass, places, share, strict=True):
        best = gains(rule, one, resolution, 1.3, grid_of_places(0.125)).max()
        (there,) = gains(rule, one, resolution, 1.3, [place])
        assert gain == pytest.approx(best, abs=0.02 if rule == 'gospa' else 0.04)
        assert there > best - (0.002 if rule == 'gospa' else 0.04)
        if rule == 'hit':
            assert there == pytest.approx(gain, abs=1e-9)


@pytest.mark.parametrize(('resolution', 'away'), [(1, 2), (4, 10)])
def test_place_of_the_most_probable_hit_stays_between_two_modes(resolution, away):
    mass = np.zeros((1, 6 * resolution, 7 * resolution))
    mass[0, 3 * resolution, [1 + resolution, 1 + resolution + away]] = 0.8, 0.2
    (place,), (gain,) = Decision(rule='hit', cutoff_cells=1.5).best_places(mass, resolution)
    (there,) = gains('hit', mass[0], resolution, 1.5, [place])
    assert there == pytest.approx(gain, abs=1e-9)
    assert gain > 0.95


@pytest.mark.parametrize('rule', RULES)
def test_of_equal_places_the_middle_is_declared(rule):
    mass = np.zeros((1, 5, 7))
    mass[0, 2, 3] = 1.0
    (place,), (gain,) = Decision(rule=rule, cutoff_cells=2.0).best_places(mass, 1)
    assert place == pytest.approx([2.0, 3.0], abs=0.126)
    assert gain > (0.9 if rule == 'gospa' else 1.0 - 1e-9)


@pytest.mark.parametrize('wait_cost', [1.0, 0.6, 0.2])
@pytest.mark.parametrize('rule', RULES)
def test_threshold_takes_the_cheapest_of_three_decisions(rng, rule, wait_cost):
    decision = Decision(rule=rule, wait_cost=wait_cost)
    log_odds, share = 3.0 * rng.standard_normal(500), rng.random(500)
    exists = 1.0 / (1.0 + np.exp(-log_odds))
    statistic, chosen = decision.statistic(log_odds, share), set()
    for false_cost in (0.1, 1.0, 4.0):
        nothing = exists
        declared = exists - exists * share + false_cost * (1.0 - exists * share)
        costs = np.stack([nothing, declared, np.full(500, wait_cost)])
        assert np.array_equal(statistic > np.log(false_cost), costs.argmin(axis=0) == 1)
        chosen |= set(costs.argmin(axis=0).tolist())
    assert chosen == ({0, 1} if wait_cost == 1.0 else {0, 1, 2})


def test_cost_is_the_expected_gospa_metric(rng):
    cutoff, exists = 1.5, 0.6
    points = [(y, x) for y in range(ROWS) for x in range(COLS)]
    prob = rng.dirichlet(np.full(len(points), 0.3))
    for place in ((0.25, 1.0), (2.0, 3.0), (1.1, 0.3)):
        found = np.array([place])
        expected = (1.0 - exists) * gospa(np.empty((0, 1)), cutoff)**2 + exists * sum(
            p * gospa(distances(np.array([point], dtype=float), found), cutoff)**2
            for p, point in zip(prob, points, strict=True))
        away = np.hypot(*(np.array(points) - place).T)
        gain = exists * prob @ worth('gospa', away, cutoff)
        assert expected / (cutoff**2 / 2.0) == pytest.approx(exists - gain + 1.0 - gain)


@pytest.mark.parametrize('rule', RULES)
def test_table_of_a_point_is_the_mean_over_the_point(rule):
    tables = gain_tables(rule, 1.5, 2)
    offset = np.array([-0.25, 0.25])
    reach = tables.shape[-1] // 2
    assert np.all(tables[:2, :, [0, -1]] == 0.0)  # nothing is cut off
    for number, (down, across) in enumerate((y, x) for y in offset for x in offset):
        for row, col in ((0, 0), (1, -2), (-3, 1)):
            inner = (np.arange(60) + 0.5) / 60 - 0.5
            away = np.hypot(row + inner[:, None] - down, col + inner - across) / 2.0
            assert tables[0, number, reach + row, reach + col] == pytest.approx(
                worth(rule, away, 1.5).mean(), abs=0.02)


@pytest.mark.parametrize('check', [
    contract.memory_is_not_changed, contract.batch_equals_single_runs,
    contract.shapes_follow_the_frame, contract.false_alarms_are_at_the_calibrated_probability,
    contract.outliers_leave_numbers_and_are_forgotten, contract.smallest_frames_leave_numbers,
], ids=lambda check: check.__name__)
@pytest.mark.parametrize(('name', 'rule'), [
    ('hmm', 'gospa'), ('bernoulli', 'hit'), ('mmtbd1', 'gospa')])
def test_contract_holds_for_every_rule(name, rule, check):
    @dataclass(frozen=True, kw_only=True)
    class WithRule(DETECTORS[name]):
        """A detector that decides by the place."""

        decision: Decision = field(default_factory=lambda: Decision(rule=rule))

    check(WithRule)


@pytest.mark.parametrize('name', sorted(DETECTORS))
def test_detector_declares_the_statistic_and_place_of_its_posterior(rng, name):
    sensor, shape = contract.SENSOR, (9, 12)
    frame = np.zeros(shape)
    frame[4, 5], frame[4, 6] = 4.0, 3.9
    answers = {}
    for rule in ('existence', *RULES):
        detector = contract.make(
            DETECTORS[name], decision=Decision(rule=rule), sensor=sensor, threshold=EVERYTHING)
        state, own = detector.init(shape), np.random.default_rng(0)
        _, answers[rule] = detector.step(state, frame, own)
    exists = answers['existence'].peak
    for rule in RULES:
        found = answers[rule]
        # Less than the mass can be gained, and both of two equal cells are within the cutoff.
        assert exists - 2.5 < found.peak < exists
        assert found.score[0] == answers['existence'].score[0]
        assert found.state[0, [0, 2]] == pytest.approx([5.5, 4.0], abs=0.3)
        assert found.state[0, [1, 3]] == pytest.approx(
            answers['existence'].state[0, [1, 3]], abs=0.1)
        assert np.linalg.eigvalsh(found.cov[0]).min() > -1e-12
    assert answers['gospa'].peak < answers['hit'].peak


@pytest.mark.parametrize(('values', 'name'), [
    ({'rule': 'risk'}, 'rule'), ({'rule': 'hit', 'cutoff_cells': 0.0}, 'cutoff_cells'),
    ({'rule': 'hit', 'wait_cost': 0.0}, 'wait_cost'), ({'wait_cost': 0.5}, 'wait_cost'),
])
def test_settings_that_mean_nothing_are_refused(values, name):
    with pytest.raises(ValueError, match=name):
        Decision(**values)
