"""
TBD1 and MMTBD1, Section V-A: existence is one more variable that the particles carry.

After Salmond and Birch (2001).  A particle is (state, mode, existence): the existence is drawn
from its Markov chain, a particle without an object has weight one, and the probability of
existence is the share of the weight that is with an object.  One mode is TBD1, several are
MMTBD1.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
from dataclasses import replace
from typing import ClassVar

from lowsnr_common.core.likelihood import state_log_ratio
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.particles import log_sum_exp
from lowsnr_common.core.particles import normalise
from lowsnr_common.core.particles import pick
from lowsnr_common.core.particles import systematic_resample
from lowsnr_common.core.particles import weighted_moments
from lowsnr_common.settings.config import check_settings
from lowsnr_common.settings.config import setting
from lowsnr_detect.parts.births import ConstantVelocity
from lowsnr_detect.parts.births import draw_births
from lowsnr_detect.parts.births import log_birth_proposal
from lowsnr_detect.parts.detector import Declarations
from lowsnr_detect.parts.existence import declare_posterior
from lowsnr_detect.parts.existence import Existence
from lowsnr_detect.parts.registry import register
import numpy as np


@dataclass(frozen=True)
class Particles:
    """
    Equally weighted particles.

    Parameters
    ----------
    exists : (..., N) ndarray of bool
        Existence of the object.
    states : (..., N, 4) ndarray
        States [m, m/s]; of no meaning where there is no object.
    modes : (..., N) ndarray of int
        Modes; likewise.

    """

    exists: np.ndarray
    states: np.ndarray
    modes: np.ndarray


@register('mmtbd1')
@dataclass(frozen=True, kw_only=True)
class MMTBD1:
    """Multiple-model particle filter whose particles carry the existence of the object."""

    feedback: ClassVar[bool] = False
    local: ClassVar[bool] = False
    # Errors of successive positions are correlated over about three frames at 6 to 9 dB.
    frames_per_declaration: ClassVar[int] = 3

    sensor: SensorModel = field(default_factory=SensorModel)
    motion: MotionModes = field(default_factory=MotionModes)
    existence: Existence = field(default_factory=Existence)
    particles: int = setting(4000, 'particles, with and without an object', ge=1, le=10_000_000)
    threshold: float = setting(
        0.0, 'log posterior odds of existence above which an object is declared [nat]', live=True)

    def __post_init__(self) -> None:
        check_settings(self)

    def nominal(self) -> MMTBD1:
        """Return the detector that declares what is more likely than not."""
        return replace(self, threshold=0.0)

    def init(self, shape: tuple[int, ...]) -> Particles | None:
        """Return the memory before the first frame: none."""
        return None

    def step(
        self, state: Particles | None, frame: np.ndarray, rng: np.random.Generator,
    ) -> tuple[Particles, Declarations]:
        """
        Move the particles, let them die and be born, weigh, and resample.

        Parameters
        ----------
        state : Particles or None
            Memory after the last frame; None before the first.
        frame : (..., rows, cols) ndarray
            Cell intensities.
        rng
            Source of randomness.

        """
        now, log_weights = self._predicted(state, frame, rng)
        ratio = state_log_ratio(self.sensor, frame, now.states)
        # What moved out of the frame is an object no more.
        exists = now.exists & (ratio > -np.inf)
        with_object = np.where(exists, log_weights + ratio, -np.inf)
        without = np.where(exists, -np.inf, 0.0)
        log_odds = log_sum_exp(with_object) - log_sum_exp(without)
        chosen = systematic_resample(np.where(exists, with_object, without), self.particles, rng)
        resampled = Particles(
            pick(exists, chosen), pick(now.states, chosen), pick(now.modes, chosen))
        return resampled, declare_posterior(
            log_odds, self.threshold,
            lambda found: weighted_moments(now.states[found], normalise(with_object[found])[0]))

    def _predicted(
        self, state: Particles | None, frame: np.ndarray, rng: np.random.Generator,
    ) -> tuple[Particles, np.ndarray]:
        """Draw existence, mode and state; return them with the log weight of the births."""
        chain, period = self.existence, self.sensor.frame_period_s
        proposal = log_birth_proposal(self.sensor.log_likelihood_ratio(frame))
        # One birth for every particle; those that need none do not use theirs.
        cells = systematic_resample(proposal, self.particles, rng)
        states, modes = draw_births(cells, frame.shape[-1], self.sensor, self.motion, rng)
        correction = -np.log(proposal.shape[-1]) - pick(proposal, cells)
        draw = rng.random(cells.shape)
        if state is None:
            return Particles(draw < chain.initial_prob, states, modes), correction
        old_modes = self.motion.switch(state.modes, period, rng)
        old_states = self.motion.move(state.states, old_modes, period, rng)
        was = state.exists
        exists = np.where(was, draw >= chain.death_prob, draw < chain.birth_prob)
        return Particles(
            exists, np.where(was[..., None], old_states, states), np.where(was, old_modes, modes),
        ), np.where(was, 0.0, correction)


@register('tbd1')
@dataclass(frozen=True, kw_only=True)
class TBD1(MMTBD1):
    """The same with one mode: constant velocity."""

    motion: ConstantVelocity = field(default_factory=ConstantVelocity)
