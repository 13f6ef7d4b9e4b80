# SPDX-License-Identifier: Apache-2.0
"""
Existence of the object, Section V, and the base of detectors that estimate its posterior.

E_k is a two-state Markov chain with the transition probabilities of birth P_b and of death P_d,
and a stated probability at the first frame.  An object exists while it is inside the frame: one
that moves out of it no longer exists, independently of P_d.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
from dataclasses import replace
from typing import Any
from typing import ClassVar
from typing import Self

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.records import Prediction
from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import setting
from lowsnr_detect.decisions.decision import Decision
from lowsnr_detect.decisions.decision import declared_at
from lowsnr_detect.parts.detector import CORRELATED_FRAMES
from lowsnr_detect.parts.detector import Declarations
from lowsnr_detect.parts.local_estimate import best_cells
from lowsnr_detect.parts.local_estimate import by_cell
from lowsnr_detect.parts.local_estimate import no_moments
from lowsnr_detect.parts.local_estimate import Posterior
import numpy as np
import scipy

# Largest log odds that the chain is advanced with: exp(-500) is still above zero in float64.
_LARGEST_LOG_ODDS = 500.0


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
            Probability that there was an object and it survives, inside the frame or not.
        absent : (...,) ndarray
            Probability that there is none.

        """
        if log_odds is None:
            return np.array(self.initial_prob), np.array(0.0), np.array(1.0 - self.initial_prob)
        # Certainty would last for ever: no object could then be born or die.
        bounded = np.clip(log_odds, -_LARGEST_LOG_ODDS, _LARGEST_LOG_ODDS)
        present, none = scipy.special.expit(bounded), scipy.special.expit(-bounded)
        return (
            self.birth_prob * none,
            (1.0 - self.death_prob) * present,
            (1.0 - self.birth_prob) * none + self.death_prob * present,
        )


def declare_posterior(
    log_odds: np.ndarray, threshold: float, decision: Decision, where: Posterior,
) -> Declarations:
    """
    Declare the one object where the statistic of the decision exceeds the threshold.

    Parameters
    ----------
    log_odds : (...,) ndarray
        Posterior log odds of existence [nat].
    threshold
        Statistic above which an object is declared [nat].
    decision
        Whether the statistic is that of existence, or of the best place.
    where
        Posterior of the state.

    Returns
    -------
    Declarations
        One slot; the score is the posterior probability of existence.

    """
    log_odds = statistic = np.asarray(log_odds)
    if decision.places:
        possible = log_odds > -np.inf
        statistic, place = np.full(log_odds.shape, -np.inf), np.zeros((*log_odds.shape, 2))
        place[possible], share = decision.best_places(where.mass(possible), where.resolution)
        statistic[possible] = decision.statistic(log_odds[possible], share)
    found = np.asarray(statistic > threshold)
    # A score of zero means no declaration, so that a tiny probability is rounded up.
    score = np.where(found, np.maximum(scipy.special.expit(log_odds), np.finfo(float).tiny), 0.0)
    mean, cov = no_moments((*found.shape, 1))
    if found.any() and decision.places:
        cells = np.floor(place[found] + 0.5).astype(np.intp)
        mean[found, 0], cov[found, 0] = declared_at(
            *where.moments(found, cells), where.cell_size_m * place[found])
    elif found.any():
        cells = best_cells(by_cell(where.mass(found), where.resolution))
        mean[found, 0], cov[found, 0] = where.moments(found, cells)
    predicted = _predicted(log_odds, found, cells, where) if found.any() else None
    return Declarations(statistic, score[..., None], mean, cov, predicted)


def _predicted(
    log_odds: np.ndarray, found: np.ndarray, cells: np.ndarray, where: Posterior,
) -> Prediction | None:
    """Return what was expected of the objects that are found; None if that is not known."""
    if where.before is None:
        return None
    prob = np.full((*found.shape, 1), np.nan)
    mean, cov = no_moments(prob.shape)
    log_ratio, mean[found, 0], cov[found, 0] = where.before(found, cells)
    prob[found, 0] = scipy.special.expit(log_odds[found] - log_ratio)
    return Prediction(prob, mean[..., POS], cov[..., POS, :][..., POS])


@dataclass(frozen=True, kw_only=True)
class PosteriorDetector:
    """Settings of a detector that declares one object by its posterior existence odds."""

    feedback: ClassVar[bool] = False
    local: ClassVar[bool] = False

    sensor: SensorModel = field(default_factory=SensorModel)
    motion: MotionModes = field(default_factory=MotionModes)
    existence: Existence = field(default_factory=Existence)
    decision: Decision = field(default_factory=Decision)
    threshold: float = setting(
        0.0, 'statistic of the decision above which an object is declared: for existence its log '
        'posterior odds [nat]', live=True)

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def frames_per_declaration(self) -> int:
        """Return the number of frames over which errors of declarations are correlated."""
        return CORRELATED_FRAMES

    def posterior(self, state: Any, shape: tuple[int, ...]) -> tuple[np.ndarray, Posterior]:
        """Return log odds of existence [nat] and the posterior of the state in a memory."""
        raise NotImplementedError

    def statistic_map(self, before: Any, frame: np.ndarray, after: Any) -> np.ndarray:
        """
        Return the log odds of an object in each cell to none in the frame, minus the threshold.

        Their sum over the cells, as odds, is that of existence; with a lag later frames are not
        used.
        """
        log_odds, where = self.posterior(after, frame.shape)
        possible, odds = np.asarray(log_odds > -np.inf), np.full(frame.shape, -np.inf)
        mass = by_cell(where.mass(possible), where.resolution)
        with np.errstate(divide='ignore'):
            share = np.log(mass / mass.sum(axis=(-2, -1), keepdims=True))
        odds[possible] = log_odds[possible, None, None] + share - self.threshold
        return odds

    def nominal(self) -> Self:
        """Return the detector that declares what is more likely than not."""
        return replace(self, threshold=0.0)

    def init(self, shape: tuple[int, ...]) -> Any:
        """Return the memory before the first frame of shape (..., rows, cols): none."""
        return None
