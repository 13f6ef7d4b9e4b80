# SPDX-License-Identifier: Apache-2.0
"""
What a detector with memory declares after an object has ended.

A detector that decides on the last m frames of a path still declares an object that ended h < m
frames ago, from the m - h frames that it was there for.  Such a declaration is neither of an
object nor of noise, so that a track has m hypotheses: its object exists (h = 0), or ended h
frames ago (h = 1 ... m - 1).

The log-likelihood ratio of m frames of an object of SNR rho is Gaussian with mean ``m rho / 2``
and variance ``m rho``; that of m - h frames has mean ``(m - h) rho / 2`` and variance
``(m - h) rho``.  The threshold follows from the detection probability P_D at h = 0.  With the log
odds x above it::

    mu_h = sigma_0 Phi^-1(P_D) - h rho / 2,   sigma_h^2 = (m - h) rho
    P_h  = Phi(mu_h / sigma_h)
    p(x | h) = N(x; mu_h, sigma_h^2) / P_h,   x > 0

A frame of noise at the end of a path adds about as much as it takes away, since it is the best of
its vicinity, and is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

from lowsnr_track.detection_model import DetectionModel
from lowsnr_track.tracks import Tracks
import numpy as np
import scipy


@dataclass(frozen=True)
class DetectorMemory:
    """
    Declarations of an object that exists, h = 0, or ended h frames ago.

    Parameters
    ----------
    mean, std : (H,) ndarray
        Mean mu_h and standard deviation sigma_h of the log odds above the threshold [nat].

    """

    mean: np.ndarray
    std: np.ndarray

    @property
    def probability(self) -> np.ndarray:
        """Probability of a declaration P_h, (H,)."""
        declared: np.ndarray = scipy.special.ndtr(self.mean / self.std)
        return declared

    def score_ratio(self, log_odds: np.ndarray) -> np.ndarray:
        """
        Return ``P_h p(x | h) / (P_0 p(x | 0))`` of declarations.

        Parameters
        ----------
        log_odds : (m,) ndarray
            Log odds x above the threshold, at least 0 [nat].

        Returns
        -------
        (H, m) ndarray
            Likelihood ratios of "ended h frames ago" against "exists"; 1 in the first row.

        """
        z = (log_odds - self.mean[:, None]) / self.std[:, None]
        log_density = -0.5 * z**2 - np.log(self.std)[:, None]
        ratio: np.ndarray = np.exp(log_density - log_density[0])
        return ratio


def detector_memory(probability: float, frames: int, snr: float) -> DetectorMemory:
    """
    Return the memory of a detector.

    Parameters
    ----------
    probability
        Detection probability P_D of an object that exists, in (0, 1).
    frames
        Frames m that a declaration rests on.
    snr
        ``rho = I^2 / sigma^2``.

    """
    ended = np.arange(frames)
    std = np.sqrt((frames - ended) * snr)
    return DetectorMemory(std[0] * scipy.special.ndtri(probability) - ended * snr / 2.0, std)


@dataclass(frozen=True)
class Endings:
    """
    Existence and recent ends of the objects of all tracks, against the detections of a frame.

    Parameters
    ----------
    detected : (T,) ndarray
        Probability that the object, existing or just ended, causes a detection in its gate.
    ratio : (T, G) ndarray
        Likelihood ratio of each detection, over that of an object that exists.
    missed : (T, H) ndarray
        Probability of each hypothesis, given that no detection is the object's.
    caused : (T, H, G) ndarray
        The same, given that a detection is.
    repetition : (T, G) ndarray
        Likelihood ratio of each detection, "false and repeated" against "of an object".

    """

    detected: np.ndarray
    ratio: np.ndarray
    missed: np.ndarray
    caused: np.ndarray
    repetition: np.ndarray

    def posterior(self, beta: np.ndarray) -> np.ndarray:
        """Return the hypotheses (T, H) from the association probabilities beta (T, G)."""
        mixed: np.ndarray = (1.0 - beta.sum(axis=1))[:, None] * self.missed
        mixed += (self.caused @ beta[..., None])[..., 0]
        return mixed


def weigh_endings(
    model: DetectionModel, memory: DetectorMemory, tracks: Tracks, score: np.ndarray,
    gated: np.ndarray,
) -> Endings:
    """
    Weigh existence and recent ends of objects by the detections in their gates.

    Parameters
    ----------
    model
        Model of the detector.
    memory
        Its memory, of H hypotheses.
    tracks
        Predicted tracks, T.
    score : (m,) ndarray
        Probabilities that the detector states, 1/2 at its threshold.
    gated : (T, G) ndarray of int
        Detections in each gate, -1 for none.

    """
    ratio = memory.score_ratio(model.log_odds(score))
    if not model.use_scores:
        ratio = np.outer(memory.probability / memory.probability[0], np.ones(len(score)))
    share = np.column_stack([tracks.existence, tracks.ended]) / tracks.followed[:, None]
    missed = share * (1.0 - memory.probability * model.gate_probability)
    caused = share[..., None] * np.swapaxes(_chosen(ratio, gated), 0, 1)
    total = caused.sum(axis=1)
    return Endings(
        1.0 - missed.sum(axis=1), total, missed / missed.sum(axis=1, keepdims=True),
        caused / total[:, None], _chosen(model.repetition(score), gated))


def _chosen(values: np.ndarray, gated: np.ndarray) -> np.ndarray:
    """Return the values (..., m) of the detections in each gate, (..., T, G); 1 of none."""
    padded = np.concatenate([values, np.ones((*values.shape[:-1], 1))], axis=-1)
    return padded[..., gated]
