# SPDX-License-Identifier: Apache-2.0
"""Existence of the objects of all tracks, updated by the detections of a frame."""

from __future__ import annotations

from dataclasses import replace

from lowsnr_track import mmpf
from lowsnr_track.detector_memory import Endings
from lowsnr_track.tracks import MAX_EXISTENCE
from lowsnr_track.tracks import Tracks
import numpy as np


def update(
    tracks: Tracks, log_ratio: np.ndarray, beta: np.ndarray, endings: Endings,
    repeated: float,
) -> Tracks:
    """
    Multiply the weights by the likelihood ratios, and update P(chi_k | Z^k).

    With the probability pi that there is an object, or just was one, and the mean likelihood
    ratio g it is ``pi g / (g_0 (1 - pi) + pi g)``, as in integrated PDA, where g_0 is one.
    False detections that rest on several frames are repeated with probability q::

        g_0 = 1 - q + q sum_j nu_j L_tj s_j

    Parameters
    ----------
    tracks
        Predicted tracks, T.
    log_ratio : (T, N) ndarray
        Log-likelihood ratio of each particle against "no object" [nat].
    beta : (T, G) ndarray
        Association probabilities.
    endings
        Existence against recent ends of the objects, and s_j (``repetition``).
    repeated
        Probability q in the frame after a false detection; half of it a frame later.

    """
    particles, log_gain = mmpf.update(tracks.particles, log_ratio)
    gain = np.exp(log_gain)
    beta = beta / _bayes(tracks.followed, gain)[:, None]  # given the object
    false = 1.0 + tracks.repeated * (gain * np.sum(beta * endings.repetition, axis=1) - 1.0)
    followed = np.minimum(_bayes(tracks.followed, gain / false), MAX_EXISTENCE)
    hypotheses = followed[:, None] * endings.posterior(beta)
    hit = beta.sum(axis=1)
    return replace(
        tracks, particles=particles, existence=hypotheses[:, 0], ended=hypotheses[:, 1:],
        repeated=hit * repeated + (1.0 - hit) * tracks.repeated / 2.0)


def update_from_posterior(tracks: Tracks, log_ratio: np.ndarray) -> Tracks:
    """
    Multiply weights and odds by what a detector with a posterior says of the frame alone.

    Such a detector knows that an object may have ended and that its answers repeat each other,
    so that the tracks need not.

    Parameters
    ----------
    tracks
        Predicted tracks, T.
    log_ratio : (T, N) ndarray
        Log-likelihood ratio of the frame for each particle [nat].

    """
    particles, log_gain = mmpf.update(tracks.particles, log_ratio)
    existence = np.minimum(_bayes(tracks.existence, np.exp(log_gain)), MAX_EXISTENCE)
    return replace(
        tracks, particles=particles, existence=existence, ended=np.zeros_like(tracks.ended),
        repeated=np.zeros_like(tracks.repeated))


def _bayes(prior: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """Return ``p r / (1 - p + p r)`` of a prior p and a likelihood ratio r."""
    posterior: np.ndarray = prior * ratio / (1.0 + prior * (ratio - 1.0))
    return posterior
