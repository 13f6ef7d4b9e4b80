# SPDX-License-Identifier: Apache-2.0
"""What a detector with memory declares after an object has ended."""

from dataclasses import replace

from lowsnr_common.core.measurement import SensorModel
from lowsnr_track.detection_model import DetectionModel
from lowsnr_track.detector_memory import detector_memory
from lowsnr_track.detector_memory import weigh_endings
from lowsnr_track.measurements import Measurements
from lowsnr_track.pda_mmpf import PdaMmpf
from lowsnr_track.track_management import TrackLife
from lowsnr_track.tracks import no_tracks
from lowsnr_track.tracks import start_tracks
import numpy as np
import pytest
from scipy.stats import norm
from track.scenes import detection
from track.scenes import everything
from track.scenes import follow


def test_declarations_match_sums_of_simulated_log_likelihood_ratios():
    """Of m frames h are after the end: the ratios z I - I^2 / 2 of the others add up."""
    frames, snr, runs = 5, 7.9, 200_000
    rng = np.random.default_rng(0)
    ratio = np.sqrt(snr) * rng.normal(np.sqrt(snr), 1.0, (runs, frames)) - snr / 2
    threshold = np.quantile(ratio.sum(axis=1), 0.1)
    memory = detector_memory(0.9, frames, snr)
    for ended in range(frames):
        excess = ratio[:, ended:].sum(axis=1) - threshold
        share = np.mean(excess > 0)
        error = 5 * np.sqrt(share * (1 - share) / runs) + 5e-3 * 0.5
        assert memory.probability[ended] == pytest.approx(share, abs=error)
        assert memory.mean[ended] == pytest.approx(excess.mean(), abs=0.1)
        assert memory.std[ended] == pytest.approx(excess.std(), rel=0.01)


def test_score_ratios_are_those_of_normal_densities():
    memory, x = detector_memory(0.8, 4, 4.0), np.array([0.0, 3.0, 12.0])
    for ended in range(4):
        expected = norm.pdf(x, memory.mean[ended], memory.std[ended]) / norm.pdf(
            x, memory.mean[0], memory.std[0])
        assert memory.score_ratio(x)[ended] == pytest.approx(expected)


@pytest.mark.parametrize('use_scores', [True, False])
def test_hypotheses_match_their_enumeration(rng, use_scores):
    """One track, two detections: miss, or either detection, under every hypothesis."""
    memory = detector_memory(0.8, 3, 6.0)
    model = DetectionModel(probability=0.8, gate_probability=0.99, use_scores=use_scores)
    prior, x = np.array([0.5, 0.2, 0.1]), np.array([1.0, 6.0])
    ratio = memory.score_ratio(x) if use_scores else np.outer(
        memory.probability / 0.8, np.ones(2))
    spatial = np.array([0.7, 2.5])  # N(z_j) / lambda_j
    miss = prior * (1 - 0.99 * memory.probability)
    joint = np.column_stack([miss, prior[:, None] * 0.99 * 0.8 * ratio * spatial])
    found = weigh_endings(
        model, memory, _track(rng, prior), 1.0 / (1.0 + np.exp(-x)), np.array([[0, 1]]))
    share = prior / prior.sum()
    assert found.detected[0] == pytest.approx(share @ (0.99 * memory.probability))
    assert found.ratio[0] == pytest.approx(share @ ratio)
    beta = joint[:, 1:].sum(axis=0) / joint.sum()
    assert found.posterior(beta[None])[0] == pytest.approx(joint.sum(axis=1) / joint.sum())


def test_a_detector_without_memory_has_one_hypothesis(rng):
    model = DetectionModel(probability=0.8, gate_probability=0.99)
    found = weigh_endings(
        model, detector_memory(0.8, 1, 6.0), _track(rng, np.array([0.3])), np.array([0.9]),
        np.array([[0, -1]]))
    assert found.detected == pytest.approx([0.8 * 0.99])
    assert found.ratio.tolist() == [[1.0, 1.0]]
    assert found.posterior(np.array([[0.4, 0.0]])).tolist() == [[1.0]]


def test_ends_age_by_the_frames_that_pass(rng):
    born = _track(rng, np.array([0.8, 0.0, 0.0, 0.0]))
    later = born.aged(np.array([0.5]), 1)
    assert later.existence == pytest.approx([0.4])
    assert later.ended.tolist() == [[0.4, 0.0, 0.0]]
    assert later.aged(np.array([1.0]), 2).ended.tolist() == [[0.0, 0.0, 0.4]]
    # Of three frames, in each of which half of the objects end.
    gap = born.aged(np.array([0.125]), 3)
    assert gap.existence == pytest.approx([0.1])
    assert gap.ended[0] == pytest.approx([0.1, 0.2, 0.4])
    assert later.aged(np.array([1.0]), 3).ended.tolist() == [[0.0, 0.0, 0.0]]
    assert later.aged(np.array([1.0]), 3).repeated == pytest.approx([0.3 / 4])
    assert no_tracks(10, 4).aged(np.empty(0), 1).ended.shape == (0, 3)


def test_an_object_that_leaves_the_frame_ends_at_once(rng):
    tracker = PdaMmpf(
        rows=16, cols=24, sensor=SensorModel(snr_db=9.0), frames_per_detection=5, particles=500)
    path = [(16.0 + 0.8 * k, 8.0) for k in range(10)]  # beyond 23.5 in the last frame but none
    frames = [[detection(*p, score=0.9999)] for p in path] + [[], []]
    outputs = follow(tracker, frames, rng)
    assert outputs[9].confirmed
    assert all(item.score < 0.3 for item in everything(outputs[11]))


def test_merged_tracks_have_probabilities_that_add_up_to_one_at_most(rng):
    one = _track(rng, np.array([0.62, 0.33]), count=2000)
    other = _track(rng, np.array([0.5, 0.0]), count=2000)
    both = replace(one.join(other), ids=np.array([1, 2]))
    managed, kept = TrackLife().manage(both)
    merged = managed[kept]
    assert len(merged) == 1
    assert merged.existence == pytest.approx([1.0 - 0.38 * 0.5])
    assert merged.ended[0] == pytest.approx([0.33 * 0.5])


def _track(rng, hypotheses, count=10):
    """Return one track, whose object exists or ended h frames ago with these probabilities."""
    measured = Measurements(np.zeros((1, 2)), np.eye(2)[None], np.array([0.9]))
    born = start_tracks(
        measured, hypotheses[:1], 1, PdaMmpf().motion, count, rng, len(hypotheses), repeated=0.3)
    return replace(born, ended=hypotheses[None, 1:])
