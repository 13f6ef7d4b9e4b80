# SPDX-License-Identifier: Apache-2.0
"""Tracks that may be unresolved, against enumeration of all groups and in simulated scenes."""

from dataclasses import replace
import itertools

from lowsnr_common.core.motion import POS
from lowsnr_track.data_association import association
from lowsnr_track.data_association.candidates import candidates
from lowsnr_track.data_association.group_hypotheses import connected_probability
from lowsnr_track.data_association.group_hypotheses import group_hypotheses
from lowsnr_track.data_association.group_hypotheses import log_weights
from lowsnr_track.data_association.unresolved import associate
from lowsnr_track.data_association.unresolved import linked_components
from lowsnr_track.detection_model import DetectionModel
from lowsnr_track.measurements import Measurements
from lowsnr_track.particles import equally_weighted
from lowsnr_track.pda_mmpf import PdaMmpf
import numpy as np
import pytest
from track.oracles import components
from track.oracles import joint_groups
from track.scenes import detection
from track.scenes import everything
from track.scenes import follow
from track.scenes import observed
from track.scenes import straight

REACH_M = 2.0
TRACKER = PdaMmpf(rows=48, cols=64, particles=1000)
MERGING = replace(TRACKER, detection=DetectionModel(resolution=2.5))


def scattered(seed, tracks, detections, width=1.0):
    """Return tracks about the origin, and detections among them that most gates hold."""
    rng = np.random.default_rng(seed)
    states = np.zeros((tracks, 40, 4))
    states[..., POS] = width * rng.standard_normal((tracks, 1, 2)) + 0.5 * rng.standard_normal(
        (tracks, 40, 2))
    root = 0.4 * rng.standard_normal((detections, 2, 2))
    measured = Measurements(
        width * rng.standard_normal((detections, 2)),
        root @ np.swapaxes(root, 1, 2) + 0.2 * np.eye(2), np.full(detections, 0.5))
    # Each detection is in two gates at least, so that all tracks are a cluster.
    inside = rng.random((tracks, detections)) < 0.7
    inside[:2] = True
    inside[:, 0] = True
    return candidates(
        equally_weighted(states, np.zeros((tracks, 40), dtype=int)), measured,
        rng.uniform(0.3, 0.99, tracks), rng.uniform(0.5, 0.95, tracks),
        np.exp(rng.normal(2.0, 1.0, (tracks, detections))),
        np.where(inside, np.arange(detections), -1))


def in_line(places, seed=0, detections=2):
    """Return narrow tracks at places (T, 2), whose gates hold all detections."""
    rng, tracks = np.random.default_rng(seed), len(places)
    states = np.zeros((tracks, 40, 4))
    states[..., POS] = np.array(places, dtype=float)[:, None] + 0.1 * rng.standard_normal(
        (tracks, 40, 2))
    measured = Measurements(
        rng.choice(states[:, 0, POS], detections) + 0.2 * rng.standard_normal((detections, 2)),
        np.tile(0.05 * np.eye(2), (detections, 1, 1)), np.full(detections, 0.5))
    return candidates(
        equally_weighted(states, np.zeros((tracks, 40), dtype=int)), measured,
        rng.uniform(0.3, 0.99, tracks), rng.uniform(0.5, 0.95, tracks),
        np.exp(rng.normal(2.0, 1.0, (tracks, detections))),
        np.tile(np.arange(detections), (tracks, 1)))


def posterior(found, given):
    """Return the probability (T, N) that each object exists and is at the particle."""
    weight = np.exp(found.log_ratio) / 40 * given.existence[:, None]
    return weight / (1.0 - given.existence + weight.sum(axis=1))[:, None]


@pytest.mark.parametrize('trial', range(10))
@pytest.mark.parametrize('tracks', [2, 3])
def test_groups_match_enumeration(tracks, trial):
    """Existence, associations and particles, with two detections."""
    given = scattered(trial, tracks, 2)
    found = associate(given, REACH_M)
    linked = given.linked(REACH_M)
    assert np.sum(linked > 0.0) == tracks * (tracks - 1)
    present, caused, shared = joint_groups(given, linked)
    assert posterior(found, given) == pytest.approx(present, rel=1e-9, abs=1e-12)
    inside = given.gated >= 0
    assert found.beta[inside] == pytest.approx(caused[inside])
    assert found.share.sum(axis=0) == pytest.approx(shared)


@pytest.mark.parametrize(('places', 'links'), [
    pytest.param([(0, 0), (1, 0), (2, 0)], 2, id='chain of three'),
    pytest.param([(0, 0), (1, 0), (2, 0), (3, 0)], 3, id='chain of four'),
    pytest.param([(1, 0), (0, 1), (-1, 0), (0, -1)], 4, id='cycle'),
    pytest.param([(0, 0), (1, 1), (-1, 1), (1, -1)], 3, id='star'),
])
def test_partly_linked_groups_match_enumeration_in_any_order(places, links):
    given = in_line(places)
    linked = given.linked(0.8)
    assert np.sum(linked > 0.0) == 2 * links
    present, caused, shared = joint_groups(given, linked)
    for order in map(list, itertools.permutations(range(len(places)))):
        found = associate(given[np.array(order)], 0.8)
        assert posterior(found, given[np.array(order)]) == pytest.approx(
            present[order], rel=1e-9, abs=1e-12)
        assert found.beta == pytest.approx(caused[order])
        assert found.share.sum(axis=0) == pytest.approx(shared)


@pytest.mark.parametrize('pairs', [
    [(0, 2), (1, 2)], [(0, 1), (1, 2), (2, 3), (0, 3)], [(0, 4), (1, 4), (2, 4), (3, 4)],
    list(itertools.combinations(range(5), 2))])
def test_prior_of_all_groups_is_one(pairs):
    tracks, rng = 1 + max(map(max, pairs)), np.random.default_rng(0)
    linked = np.zeros((tracks, tracks))
    for pair in pairs:
        linked[pair] = linked[pair[::-1]] = rng.uniform(0.1, 0.9)
    groups, chosen = group_hypotheses(np.zeros((tracks, 0), dtype=int), linked)
    prior = np.exp(log_weights(
        groups, chosen, np.zeros(len(groups.cause)), rng.uniform(0.3, 0.9, tracks), linked))
    assert prior.sum() == pytest.approx(1.0)
    assert len(np.unique(chosen, axis=0)) == len(chosen)


def test_of_many_linked_tracks_all_are_associated():
    """A chain of twenty: each track differs from one that is resolved; same in reverse order."""
    given = in_line([(n, 0) for n in range(20)], detections=3)
    assert np.sum(given.linked(0.8) > 0.0) == 38
    found, resolved = (associate(given, reach) for reach in (0.8, 0.0))
    assert np.all(np.isfinite(found.log_ratio))
    assert np.all(abs(found.beta - resolved.beta).max(axis=1) > 0.0)
    reverse = associate(given[np.arange(20)[::-1]], 0.8)
    assert posterior(reverse, given[np.arange(20)[::-1]])[::-1] == pytest.approx(
        posterior(found, given), rel=1e-9, abs=1e-12)


def test_components_keep_the_strongest_links():
    """Of a chain the hypotheses of which are too many, the link in the middle is the weakest."""
    chance = np.array([0.5, 0.6, 0.4, 0.1, 0.7, 0.5, 0.6])
    linked = np.diag(chance, 1) + np.diag(chance, -1)
    assert linked_components(linked, np.full(8, 2)) == [[0, 1, 2, 3], [4, 5, 6, 7]]
    assert linked_components(linked, np.full(8, 4000)) == []


@pytest.mark.parametrize('existence', [[0.0, 0.7], [1.0, 0.7], [0.0, 1.0], [1.0, 1.0]])
@pytest.mark.parametrize('detected', [0.9, 1.0])
@pytest.mark.filterwarnings('error')
def test_certain_existence_and_detection_are_the_limit(existence, detected):
    given = in_line([(0, 0), (1, 0)])
    exact = replace(given, existence=np.array(existence), detected=np.full(2, detected))
    near = replace(given, existence=np.clip(existence, 1e-9, 1.0 - 1e-9),
                   detected=np.full(2, min(detected, 1.0 - 1e-9)))
    found, limit = associate(exact, 0.8), associate(near, 0.8)
    assert np.exp(found.log_ratio) == pytest.approx(np.exp(limit.log_ratio), rel=1e-5, abs=1e-7)
    assert found.beta == pytest.approx(limit.beta, rel=1e-5, abs=1e-7)


def test_probability_of_being_unresolved_is_that_of_a_simulation():
    given, rng = scattered(3, 3, 2), np.random.default_rng(0)
    mean, cov = (part[..., POS] for part in given.particles.moments)
    variance = np.median(np.diagonal(given.measured.cov, axis1=1, axis2=2), axis=0)
    seen = np.stack([
        rng.multivariate_normal(mean[t], cov[t][POS] + np.diag(variance), 200_000)
        for t in range(3)])
    near = (abs(seen[:, None] - seen) <= REACH_M).all(axis=-1).mean(axis=-1)
    off = ~np.eye(3, dtype=bool)
    # Five standard deviations; the axes of a track are taken as independent.
    assert given.linked(REACH_M)[off] == pytest.approx(near[off], abs=0.03)


@pytest.mark.parametrize('size', [1, 2, 3, 4])
def test_connected_probability_matches_enumeration_of_links(size):
    chances = np.random.default_rng(size).uniform(0.1, 0.9, (size, size))
    linked = np.triu(chances, 1) + np.triu(chances, 1).T
    pairs, total = list(itertools.combinations(range(size), 2)), 0.0
    for links in itertools.product((False, True), repeat=len(pairs)):
        if len(components(range(size), itertools.compress(pairs, links))) == 1:
            total += np.prod([linked[pair] if link else 1.0 - linked[pair]
                              for pair, link in zip(pairs, links)])
    assert connected_probability(linked)[-1] == pytest.approx(total)


def test_connected_probability_of_weak_links_keeps_its_digits():
    linked = np.diag(np.full(7, 1e-3), 1) + np.diag(np.full(7, 1e-3), -1)
    assert connected_probability(linked)[-1] == pytest.approx(1e-21, rel=1e-9, abs=0.0)
    assert connected_probability(linked)[0b101] == 0.0


@pytest.mark.parametrize(('reach', 'width'), [(0.0, 1.0), (REACH_M, 1e3)])
def test_without_unresolved_tracks_nothing_changes(reach, width):
    for trial in range(5):
        given = scattered(trial, 3, 3, width)
        found = associate(given, reach)
        log_ratio, beta = association.associate(
            given.existence, given.detected, given.ratio, given.mean, given.gated)
        assert found.log_ratio.tobytes() == log_ratio.tobytes()
        assert found.beta.tobytes() == found.share.tobytes() == beta.tobytes()


def test_tracks_far_from_each_other_are_the_same_bytes():
    frames = [observed(places, (64, 48), np.random.default_rng(k)) for k, places in enumerate(
        zip(straight(20), straight(20, (30.0, 10.0)), straight(20, (10.0, 40.0), (0.4, -0.3))))]
    one, other = (follow(each, frames, np.random.default_rng(1)) for each in (TRACKER, MERGING))
    assert len(one[-1].confirmed) == 3
    for left, right in zip(one, other):
        for first, second in zip(everything(left), everything(right), strict=True):
            assert first.id == second.id
            assert first.score == second.score
            assert first.state.tobytes() == second.state.tobytes()
            assert first.cov.tobytes() == second.cov.tobytes()


def test_one_object_beside_which_there_was_a_false_detection_has_one_track():
    counts = []
    for seed in range(10):
        frames = [[detection(*place, score=0.99)] for place in straight(30)]
        frames[1].append(detection(*(straight(30)[1] + [1.5, 0.0]), score=0.99))
        counts.append([
            len(each.confirmed) for each in follow(MERGING, frames, np.random.default_rng(seed))])
    assert np.mean(np.array(counts)[:, 2:]) == 1.0
