"""
Whether there is an object: the two-state Markov chain of Section V, and what follows from it.

The chain E_k starts with a stated probability at the first frame.  An object exists while it
is inside the frame: one that moves out of it is gone, whatever P_d says.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from lowsnr_common.settings.config import check_settings
from lowsnr_common.settings.config import setting
from lowsnr_detect.parts.detector import Declarations
import numpy as np
from scipy.special import expit

_CERTAIN = 500.0


@dataclass(frozen=True, kw_only=True)
class Existence:
    """Birth, death and initial probability of the object."""

    birth_prob: float = setting(
        0.02, 'probability P_b that an object appears from a frame to the next', gt=0.0, lt=1.0)
    death_prob: float = setting(
        0.02, 'probability P_d that an object disappears from a frame to the next',
        gt=0.0, lt=1.0)
    initial_prob: float = setting(
        0.02, 'probability that there is an object in the first frame', gt=0.0, lt=1.0)

    def __post_init__(self) -> None:
        check_settings(self)

    def predict(self, log_odds: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Advance the chain by a frame.

        Parameters
        ----------
        log_odds : (...,) ndarray or None
            Posterior log odds of existence [nat]; None before the first frame.

        Returns
        -------
        born : (...,) ndarray
            Probability that an object has just appeared.
        stays : (...,) ndarray
            Probability that there was an object and it lives on, inside the frame or not.
        absent : (...,) ndarray
            Probability that there is none.

        """
        if log_odds is None:
            return np.array(self.initial_prob), np.array(0.0), np.array(1.0 - self.initial_prob)
        # Certainty would be for ever: the object could never be born anywhere else.
        bounded = np.clip(log_odds, -_CERTAIN, _CERTAIN)
        present, none = expit(bounded), expit(-bounded)
        return (
            self.birth_prob * none,
            (1.0 - self.death_prob) * present,
            (1.0 - self.birth_prob) * none + self.death_prob * present,
        )


def declare_posterior(
    log_odds: np.ndarray, threshold: float,
    moments: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
) -> Declarations:
    """
    Declare the one object, where its existence is likely enough.

    Parameters
    ----------
    log_odds : (...,) ndarray
        Posterior log odds of existence [nat].
    threshold
        Log odds above which an object is declared [nat].
    moments
        Given which runs declare, (...,) of bool, returns the posterior mean (found, 4) and
        covariance (found, 4, 4) of these [m, m/s].

    Returns
    -------
    Declarations
        One slot; the score is the posterior probability of existence.

    """
    found = np.asarray(log_odds > threshold)
    # The smallest positive number keeps a declaration of next to no probability a declaration.
    score = np.where(found, np.maximum(expit(log_odds), np.finfo(float).tiny), 0.0)
    mean = np.full((*found.shape, 1, 4), np.nan)
    cov = np.full((*found.shape, 1, 4, 4), np.nan)
    if found.any():
        mean[found, 0], cov[found, 0] = moments(found)
    return Declarations(np.asarray(log_odds), score[..., None], mean, cov)
