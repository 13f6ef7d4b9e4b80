# SPDX-License-Identifier: Apache-2.0
"""Gating, likelihoods and joint association against closed forms and enumeration."""

from lowsnr_track.data_association.association import associate
from lowsnr_track.data_association.association import association_probabilities
from lowsnr_track.data_association.association import gate
from lowsnr_track.data_association.association import log_likelihoods
from lowsnr_track.data_association.association import sum_over_tracks
from lowsnr_track.data_association.joint_association import clusters
from lowsnr_track.data_association.joint_association import log_exclusion
from lowsnr_track.measurements import Measurements
from lowsnr_track.particles import equally_weighted
import numpy as np
import pytest
from scipy.stats import multivariate_normal
from track import oracles


def measurements(positions, rng):
    root = rng.standard_normal((len(positions), 2, 2))
    cov = root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(2)
    return Measurements(np.asarray(positions, dtype=float), cov, np.full(len(positions), 0.5))


def beta_of(psi):
    """Return beta (T, m) of a dense matrix of odds psi."""
    with np.errstate(divide='ignore'):
        log_psi = np.log(psi)
    gated = np.where(psi > 0, np.arange(psi.shape[1]), -1)
    return association_probabilities(log_psi, log_exclusion(log_psi, gated))


def particles_at(positions):
    """Return particles (T, N) at positions (T, N, 2)."""
    states = np.zeros((*np.shape(positions)[:2], 4))
    states[..., [0, 2]] = positions
    return equally_weighted(states, np.zeros(states.shape[:2], dtype=int))


def test_gate_holds_detections_near_any_particle(rng):
    measured = measurements(rng.uniform(0, 30, (60, 2)), rng)
    particles = particles_at(rng.uniform(0, 30, (4, 1, 2)) + rng.standard_normal((4, 50, 2)))
    gated = gate(particles, measured, 9.0, 100)
    for t in range(4):
        found = gated[t][gated[t] >= 0]
        offset = measured.position[:, None] - particles.states[t][:, [0, 2]]
        squared = np.einsum('mni,mij,mnj->mn', offset, np.linalg.inv(measured.cov), offset)
        assert set(np.flatnonzero(squared.min(axis=1) <= 9.0)) <= set(found)
        reach = 3.0 * np.sqrt(np.einsum('mii->mi', measured.cov))[:, None] + 1e-9
        beyond = np.all(np.any(abs(offset) > reach + np.ptp(offset, axis=1)[:, None], axis=-1), 1)
        assert not set(np.flatnonzero(beyond)) & set(found)


def test_gate_holds_both_parts_of_split_particles(rng):
    measured = measurements([[0, 0], [20, 0]], rng)
    split = np.where(np.arange(100) < 3, 20.0, 0.0)
    particles = particles_at(np.stack([split, np.zeros(100)], axis=-1)[None])
    assert gate(particles, measured, 9.0, 5).tolist() == [[0, 1]]


def test_gate_keeps_the_nearest(rng):
    measured = measurements([[0, 0], [1, 0], [2, 0], [3, 0]], rng)
    measured = Measurements(measured.position, np.stack([np.eye(2)] * 4), measured.score)
    assert gate(particles_at([[[2.1, 0.0]] * 5]), measured, 100.0, 2).tolist() == [[2, 3]]


def test_gate_without_detections_is_empty(rng):
    none = measurements(np.empty((0, 2)), rng)
    assert gate(particles_at(np.zeros((3, 10, 2))), none, 9.0, 5).shape == (3, 0)


def test_log_likelihoods_match_scipy(rng):
    measured = measurements([[1, 2], [3, 4]], rng)
    particles = equally_weighted(rng.standard_normal((1, 5, 4)), np.zeros((1, 5), dtype=int))
    found = log_likelihoods(particles, measured, np.array([[1, -1]]))
    normal = multivariate_normal(measured.position[1], measured.cov[1])
    assert found[0, 0] == pytest.approx(normal.logpdf(particles.states[0][:, [0, 2]]))
    assert np.all(found[0, 1] == -np.inf)


def test_probabilities_of_one_track_match_closed_form():
    psi = np.array([[0.5, 2.0, 0.1]])
    assert beta_of(psi) == pytest.approx(psi / 3.6)


def test_probabilities_without_detections_are_empty():
    assert beta_of(np.empty((2, 0))).shape == (2, 0)


def test_tracks_that_share_one_detection_match_enumeration():
    psi = np.array([[3.0, 0.0, 8.0], [0.2, 0.0, 0.0], [5.0, 7.0, 0.0]])
    assert beta_of(psi) == pytest.approx(oracles.joint_marginals(psi)[:, :3])


@pytest.mark.parametrize('trial', range(20))
def test_joint_association_matches_enumeration(trial):
    rng = np.random.default_rng(trial)
    psi = np.exp(rng.normal(0.0, 3.0, (3, 4))) * (rng.random((3, 4)) < 0.7)
    assert beta_of(psi) == pytest.approx(oracles.joint_marginals(psi)[:, :4])


@pytest.mark.parametrize('apart', [0.5, 1.0, 2.0, 3.0])
def test_large_cluster_is_approximated(monkeypatch, apart):
    """Four objects in a line, so many errors of a detection apart: the largest errors of beta."""
    monkeypatch.setattr('lowsnr_track.data_association.joint_association._MAX_HYPOTHESES', 1)
    error = []
    for trial in range(50):
        rng = np.random.default_rng(trial)
        place = apart * np.arange(4)
        seen = place[rng.random(4) < 0.9]
        found = np.append(
            seen + rng.standard_normal(len(seen)), rng.uniform(-3.0, 4.0 * apart + 3.0))
        squared = (found - place[:, None])**2
        psi = 18.0 * np.exp(-0.5 * squared) * (squared < 14.0)
        error.append(np.abs(beta_of(psi) - oracles.joint_marginals(psi)[:, :len(found)]).max())
    assert np.max(error) < 0.13
    assert np.mean(error) < 0.05


def test_beta_of_a_certain_object_is_that_of_the_pda_filter(rng):
    """With existence 1: beta_j = L_j / (1 - P_D P_G + sum L), the rest for no detection."""
    ratio, detected = np.exp(rng.normal(0.0, 2.0, (1, 3, 6))), 0.8
    log_ratio, beta = associate(
        np.ones(1), np.array([detected]), ratio, ratio.mean(axis=-1), np.array([[0, 1, 2]]))
    likelihood = ratio[0].mean(axis=1)
    assert beta[0] == pytest.approx(likelihood / (1 - detected + likelihood.sum()))
    assert np.exp(log_ratio[0]) == pytest.approx(1 - detected + ratio[0].sum(axis=0))


@pytest.mark.parametrize('trial', range(10))
def test_particles_of_tracks_that_share_detections_match_enumeration(trial):
    """The joint probability that each object exists and is at each particle."""
    rng = np.random.default_rng(trial)
    tracks, count, size, detected = 3, 4, 5, 0.7
    ratio = np.exp(rng.normal(0.0, 2.0, (tracks, count, size)))
    ratio *= rng.random((tracks, count, 1)) < 0.7
    existence = rng.uniform(0.1, 0.99, tracks)
    gated = np.where(ratio[..., 0] > 0.0, np.arange(count), -1)
    log_ratio, beta = associate(
        existence, np.full(tracks, detected), ratio, ratio.mean(axis=-1), gated)
    expected, marginal = oracles.joint_particles(ratio, existence, detected)
    weight = np.exp(log_ratio) / size * existence[:, None]
    assert weight / (1 - existence + weight.sum(axis=1))[:, None] == pytest.approx(expected)
    assert beta == pytest.approx(marginal)


def test_sum_over_tracks_adds_up_each_detection():
    gated = np.array([[2, 0], [2, -1]])
    beta = np.array([[0.3, 0.1], [0.4, 0.0]])
    assert sum_over_tracks(beta, gated, 4) == pytest.approx([0.1, 0.0, 0.7, 0.0])


def test_huge_odds_give_finite_probabilities():
    found = beta_of(np.array([[1e300, 1e300], [1e300, 1e-300]]))
    assert np.all(np.isfinite(found))
    assert found[1, 0] <= 1.0


def test_clusters_are_the_connected_components(rng):
    for _ in range(300):
        tracks, slots, detections = rng.integers(1, [12, 5, 20])
        index = rng.integers(-1, detections, (tracks, slots))
        shares = np.array([
            [bool(set(one) & set(two) - {-1}) for two in index.tolist()]
            for one in index.tolist()]) | np.eye(tracks, dtype=bool)
        linked = np.linalg.matrix_power(shares.astype(int), tracks) > 0
        expected = [np.flatnonzero(row).tolist() for row in np.unique(linked, axis=0)[::-1]]
        found = [cluster.tolist() for cluster in clusters(index)]
        assert sorted(found) == sorted(group for group in expected if len(group) > 1)
