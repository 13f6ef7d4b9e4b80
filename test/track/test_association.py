"""Gating, likelihoods and joint association against closed forms and enumeration."""

from lowsnr_track.association import association_probabilities
from lowsnr_track.association import gate
from lowsnr_track.association import log_densities
from lowsnr_track.association import log_shares
from lowsnr_track.joint_association import clusters
from lowsnr_track.measurements import Measurements
from lowsnr_track.mmpf import uniform_cloud
import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.stats import multivariate_normal
from track import oracles


def measurements(positions, rng):
    root = rng.standard_normal((len(positions), 2, 2))
    cov = root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(2)
    return Measurements(np.asarray(positions, dtype=float), cov, np.full(len(positions), 0.5))


def beliefs(claim):
    """Return beta (T, m) of a dense matrix of claims."""
    with np.errstate(divide='ignore'):
        log_claim = np.log(claim)
    index = np.where(claim > 0, np.arange(claim.shape[1]), -1)
    return association_probabilities(log_claim, log_shares(log_claim, index))


def cloud_of(positions):
    """Return clouds (T, N) at positions (T, N, 2)."""
    states = np.zeros((*np.shape(positions)[:2], 4))
    states[..., [0, 2]] = positions
    return uniform_cloud(states, np.zeros(states.shape[:2], dtype=int))


def test_gate_holds_what_is_near_any_particle(rng):
    measured = measurements(rng.uniform(0, 30, (60, 2)), rng)
    cloud = cloud_of(rng.uniform(0, 30, (4, 1, 2)) + rng.standard_normal((4, 50, 2)))
    index = gate(cloud, measured, 9.0, 100)
    for t in range(4):
        found = index[t][index[t] >= 0]
        offset = measured.position[:, None] - cloud.states[t][:, [0, 2]]
        squared = np.einsum('mni,mij,mnj->mn', offset, np.linalg.inv(measured.cov), offset)
        assert set(np.flatnonzero(squared.min(axis=1) <= 9.0)) <= set(found)
        reach = 3.0 * np.sqrt(np.einsum('mii->mi', measured.cov))[:, None] + 1e-9
        beyond = np.all(np.any(abs(offset) > reach + np.ptp(offset, axis=1)[:, None], axis=-1), 1)
        assert not set(np.flatnonzero(beyond)) & set(found)


def test_gate_holds_both_halves_of_a_split_cloud(rng):
    measured = measurements([[0, 0], [20, 0]], rng)
    split = np.where(np.arange(100) < 3, 20.0, 0.0)
    cloud = cloud_of(np.stack([split, np.zeros(100)], axis=-1)[None])
    assert gate(cloud, measured, 9.0, 5).tolist() == [[0, 1]]


def test_gate_keeps_the_nearest(rng):
    measured = measurements([[0, 0], [1, 0], [2, 0], [3, 0]], rng)
    measured = Measurements(measured.position, np.stack([np.eye(2)] * 4), measured.score)
    assert gate(cloud_of([[[2.1, 0.0]] * 5]), measured, 100.0, 2).tolist() == [[2, 3]]


def test_gate_of_nothing_is_empty(rng):
    none = measurements(np.empty((0, 2)), rng)
    assert gate(cloud_of(np.zeros((3, 10, 2))), none, 9.0, 5).shape == (3, 0)


def test_log_densities_match_scipy(rng):
    measured = measurements([[1, 2], [3, 4]], rng)
    cloud = uniform_cloud(rng.standard_normal((1, 5, 4)), np.zeros((1, 5), dtype=int))
    found = log_densities(cloud, measured, np.array([[1, -1]]))
    normal = multivariate_normal(measured.position[1], measured.cov[1])
    assert found[0, 0] == pytest.approx(normal.logpdf(cloud.states[0][:, [0, 2]]))
    assert np.all(found[0, 1] == -np.inf)


def test_probabilities_of_one_track_match_closed_form():
    claim = np.array([[0.5, 2.0, 0.1]])
    assert beliefs(claim) == pytest.approx(claim / 3.6)


def test_probabilities_without_detections_are_empty():
    assert beliefs(np.empty((2, 0))).shape == (2, 0)


def test_tracks_that_share_one_detection_match_enumeration():
    claim = np.array([[3.0, 0.0, 8.0], [0.2, 0.0, 0.0], [5.0, 7.0, 0.0]])
    assert beliefs(claim) == pytest.approx(oracles.joint_marginals(claim)[:, :3])


@pytest.mark.parametrize('trial', range(20))
def test_joint_association_matches_enumeration(trial):
    rng = np.random.default_rng(trial)
    claim = np.exp(rng.normal(0.0, 3.0, (3, 4))) * (rng.random((3, 4)) < 0.7)
    assert beliefs(claim) == pytest.approx(oracles.joint_marginals(claim)[:, :4])


def test_large_cluster_is_approximated(monkeypatch):
    """Belief propagation: its mean error over random clusters is a few hundredths."""
    monkeypatch.setattr('lowsnr_track.association._MOST_HYPOTHESES', 1)
    error = []
    for trial in range(50):
        rng = np.random.default_rng(trial)
        claim = np.exp(rng.normal(0.0, 2.0, (3, 4))) * (rng.random((3, 4)) < 0.7)
        error.append(beliefs(claim) - oracles.joint_marginals(claim)[:, :4])
    assert np.mean(np.abs(error)) < 0.03


def test_huge_claims_stay_finite():
    found = beliefs(np.array([[1e300, 1e300], [1e300, 1e-300]]))
    assert np.all(np.isfinite(found))
    assert found[1, 0] <= 1.0


def test_clusters_are_the_connected_components(rng):
    for _ in range(300):
        tracks, slots, detections = rng.integers(1, [12, 5, 20])
        index = rng.integers(-1, detections, (tracks, slots))
        track, slot = np.nonzero(index >= 0)
        size = tracks + detections
        graph = coo_array(
            (np.ones(track.size), (track, tracks + index[track, slot])), shape=(size, size))
        label = connected_components(graph, directed=False)[1][:tracks]
        expected = [np.flatnonzero(label == each).tolist() for each in dict.fromkeys(label)]
        found = [cluster.tolist() for cluster in clusters(index)]
        assert found == [group for group in expected if len(group) > 1]
