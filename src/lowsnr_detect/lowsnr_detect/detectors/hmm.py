"""
HMM: the Bayes-Markov filter on the grid of cells, exact for what its moves assume.

The belief is the probability of every cell together with up to two last moves, and the
existence of the object (Section V); frame by frame it is moved on, mixed with births and
multiplied with the likelihood ratio of every cell.  Nothing is sampled and no path is dropped,
so that no detector with the same assumptions does better.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
from dataclasses import replace
from typing import ClassVar

from lowsnr_common.core.destination import Destination
from lowsnr_common.core.likelihood import relative_likelihood
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.settings.config import check_settings
from lowsnr_common.settings.config import setting
from lowsnr_detect.parts.destination_moves import favoured_cells
from lowsnr_detect.parts.destination_moves import favoured_moves
from lowsnr_detect.parts.detector import Declarations
from lowsnr_detect.parts.existence import declare_posterior
from lowsnr_detect.parts.existence import Existence
from lowsnr_detect.parts.grid_filter import born_belief
from lowsnr_detect.parts.grid_filter import cell_moments
from lowsnr_detect.parts.grid_filter import expect_belief
from lowsnr_detect.parts.grid_filter import move_and_weigh
from lowsnr_detect.parts.grid_filter import over_runs
from lowsnr_detect.parts.grid_filter import total
from lowsnr_detect.parts.moves import move_model
from lowsnr_detect.parts.moves import MoveModel
from lowsnr_detect.parts.registry import register
import numpy as np

# An outlier may leave nothing else possible; what is so is not zero, so that it has a log.
_IMPOSSIBLE = 1e-200


@dataclass(frozen=True)
class Belief:
    """
    What is known after a frame.

    Parameters
    ----------
    weights : (dropped, kept, ..., rows, cols) ndarray
        How likely history and cell are, given that there is an object; with sum ``mass``.
    mass : (...,) ndarray
        What the weights sum up to.
    log_odds : (...,) ndarray
        Log odds of existence [nat].
    likelihood : (..., rows, cols) ndarray
        Likelihood ratio of the frame, over its largest.
    peak : (...,) ndarray
        Log of the largest [nat].
    frame
        Number of the frame, from 1.

    """

    weights: np.ndarray
    mass: np.ndarray
    log_odds: np.ndarray
    likelihood: np.ndarray
    peak: np.ndarray
    frame: int

    @property
    def given(self) -> np.ndarray:
        """Probability of history and cell, (dropped, kept, ..., rows, cols)."""
        return self.weights / _plane(self.mass)


@register('hmm')
@dataclass(frozen=True, kw_only=True)
class HMM:
    """Forward recursion of ``p(cell, last moves, E_k | Z^k)``, with an optional fixed lag."""

    feedback: ClassVar[bool] = False
    local: ClassVar[bool] = False
    # Errors of successive positions are correlated over about three frames at 6 to 9 dB.
    frames_per_declaration: ClassVar[int] = 3

    sensor: SensorModel = field(default_factory=SensorModel)
    motion: MotionModes = field(default_factory=MotionModes)
    existence: Existence = field(default_factory=Existence)
    destination: Destination = field(default_factory=Destination)
    order: int = setting(2, 'last moves that the next one depends on', ge=0, le=2)
    regions: int = setting(
        1, 'sub-regions of the frame that are worked on in parallel; the result is the same',
        ge=1, le=64)
    lag: int = setting(
        0, 'frames that an answer waits for; it is then about the frame so long ago', ge=0, le=20)
    threshold: float = setting(
        0.0, 'log posterior odds of existence above which an object is declared [nat]', live=True)

    def __post_init__(self) -> None:
        check_settings(self)
        if self.lag and self.destination.probability:
            raise ValueError(
                f'HMM.lag = {self.lag}, must be 0 where destination.probability is above 0')

    def nominal(self) -> HMM:
        """Return the detector that declares what is more likely than not."""
        return replace(self, threshold=0.0)

    def init(self, shape: tuple[int, ...]) -> tuple[Belief, ...]:
        """Return the beliefs of the last ``lag + 1`` frames, none at first."""
        return ()

    def step(
        self, state: tuple[Belief, ...], frame: np.ndarray, rng: np.random.Generator,
    ) -> tuple[tuple[Belief, ...], Declarations]:
        """
        Advance by a frame and declare the object of the frame ``lag`` frames ago.

        Parameters
        ----------
        state : tuple of Belief
            Beliefs after the last frames, the newest last.
        frame : (..., rows, cols) ndarray
            Cell intensities.
        rng
            Not used; the filter is deterministic.

        """
        model = move_model(self.motion, self.sensor, self.order)
        state = (*state[-self.lag or len(state):], self._filtered(model, state, frame))
        log_odds, weights, mass = self._smoothed(model, state)
        if len(state) <= self.lag:
            log_odds = np.full_like(log_odds, -np.inf)
        return state, declare_posterior(
            log_odds, self.threshold, lambda found: cell_moments(
                weights[:, :, found] / _plane(mass[found]), model, self.sensor.cell_size_m))

    def _filtered(
        self, model: MoveModel, state: tuple[Belief, ...], frame: np.ndarray,
    ) -> Belief:
        """Predict and weigh, with the mass of the belief in the log odds."""
        last = state[-1] if state else None
        born, stays, absent = self.existence.predict(last.log_odds if last else None)
        likelihood, peak = relative_likelihood(self.sensor, frame)
        number = last.frame + 1 if last else 1
        if last is None:
            weights = self._born(model, number, frame.shape) * (_plane(born) * likelihood)
            mass = total(weights)
        else:
            weights, inside, mass = self._moved(model, last, likelihood, stays, born)
            absent = absent + stays * (1.0 - inside)
        log_odds = np.log(mass) + peak - np.log(absent)
        return Belief(weights, mass, log_odds, likelihood, peak, number)

    def _born(self, model: MoveModel, number: int, shape: tuple[int, ...]) -> np.ndarray:
        """Return where an object appears in a frame."""
        born = born_belief(model, shape)
        if not self.destination.is_ahead(number):
            return born
        rows, cols = shape[-2:]
        return born * over_runs(favoured_cells(
            self.destination, self.motion, self.sensor, self.order, number, (rows, cols),
        ), len(shape) - 2)

    def _moved(
        self, model: MoveModel, last: Belief, likelihood: np.ndarray, stays: np.ndarray,
        born: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the belief moved on, with births and weighed, what is left inside, the sum."""
        number, share = last.frame + 1, 1.0 / last.mass
        if not self.destination.is_ahead(number):
            moved, inside, mass = move_and_weigh(
                model, last.weights, likelihood, stays * share, born, regions=self.regions)
            return moved, inside * share, mass
        rows, cols = likelihood.shape[-2:]
        favour, mean = favoured_moves(
            self.destination, self.motion, self.sensor, self.order, number, (rows, cols))
        belief = last.given / over_runs(mean, last.weights.ndim - 4)
        moved, inside, _ = move_and_weigh(
            model, belief, likelihood, stays, np.zeros_like(born), favour, self.regions)
        moved += self._born(model, number, likelihood.shape) * (_plane(born) * likelihood)
        return moved, inside, total(moved)

    def _smoothed(
        self, model: MoveModel, state: tuple[Belief, ...],
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return log odds, belief and its sum of the oldest frame, given all to the newest."""
        then = state[0]
        if len(state) == 1:
            return then.log_odds, then.weights, then.mass
        # Likelihood of the later frames, relative to that without an object in this one.
        ahead = np.ones_like(then.weights)
        chain, anywhere = self.existence, born_belief(model, then.likelihood.shape)
        inside = np.ones((*model.history.shape, *then.likelihood.shape[-2:]))
        lives_on = 1.0 - chain.death_prob
        gone = 1.0 - lives_on * expect_belief(model, inside)
        gone = gone.reshape(*model.history.shape, *[1] * then.log_odds.ndim, *inside.shape[-2:])
        for later in state[:0:-1]:
            peak = np.maximum(later.peak, 0.0)
            value = ahead * later.likelihood * _plane(np.exp(later.peak - peak))
            nothing = np.exp(-peak)
            appears = total(anywhere * value)
            empty = (1.0 - chain.birth_prob) * nothing + chain.birth_prob * appears
            ahead = lives_on * expect_belief(model, value) + gone * _plane(nothing)
            ahead = np.maximum(ahead / _plane(empty), _IMPOSSIBLE)
        given = then.given * ahead
        mass = total(given)
        return then.log_odds + np.log(mass), given, mass


def _plane(value: np.ndarray) -> np.ndarray:
    """Give (...,) the axes of rows and columns."""
    return value[..., None, None]
