"""
TBD2 and MMTBD2, Section V-B: a continuing cloud, a birth cloud, and presence from their sums.

After Rutten, Gordon and Maskell (2005).  The density of the state is that given an object; the
presence probability follows from the sums of the unnormalised weights of the particles that
lived on and of those that were born.  One mode is TBD2, several are MMTBD2.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
from dataclasses import replace
from typing import ClassVar

from lowsnr_common.core.destination import Destination
from lowsnr_common.core.destination import favour_of_states
from lowsnr_common.core.destination import move_towards
from lowsnr_common.core.likelihood import state_log_ratio
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
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
class Cloud:
    """
    Equally weighted particles given that there is an object, and how likely that is.

    Parameters
    ----------
    states : (..., N, 4) ndarray
        States [m, m/s].
    modes : (..., N) ndarray of int
        Modes.
    log_odds : (...,) ndarray
        Log odds of existence [nat].
    frame
        Number of the frame, from 1.

    """

    states: np.ndarray
    modes: np.ndarray
    log_odds: np.ndarray
    frame: int


@register('mmtbd2')
@dataclass(frozen=True, kw_only=True)
class MMTBD2:
    """Multiple-model particle filter with a birth cloud and a continuing cloud."""

    feedback: ClassVar[bool] = False
    local: ClassVar[bool] = False
    # Errors of successive positions are correlated over about three frames at 6 to 9 dB.
    frames_per_declaration: ClassVar[int] = 3

    sensor: SensorModel = field(default_factory=SensorModel)
    motion: MotionModes = field(default_factory=MotionModes)
    existence: Existence = field(default_factory=Existence)
    destination: Destination = field(default_factory=Destination)
    particles: int = setting(3000, 'particles of the continuing cloud', ge=1, le=10_000_000)
    birth_particles: int = setting(1000, 'particles of the birth cloud', ge=1, le=10_000_000)
    threshold: float = setting(
        0.0, 'log posterior odds of existence above which an object is declared [nat]', live=True)

    def __post_init__(self) -> None:
        check_settings(self)

    def nominal(self) -> MMTBD2:
        """Return the detector that declares what is more likely than not."""
        return replace(self, threshold=0.0)

    def init(self, shape: tuple[int, ...]) -> Cloud | None:
        """Return the memory before the first frame: none."""
        return None

    def step(
        self, state: Cloud | None, frame: np.ndarray, rng: np.random.Generator,
    ) -> tuple[Cloud, Declarations]:
        """
        Predict both clouds, weigh them, find the presence probability, and resample.

        Parameters
        ----------
        state : Cloud or None
            Memory after the last frame; None before the first.
        frame : (..., rows, cols) ndarray
            Cell intensities.
        rng
            Source of randomness.

        """
        born, stays, absent = self.existence.predict(state.log_odds if state else None)
        number = state.frame + 1 if state else 1
        states, modes, log_weights = self._births(number, frame, rng)
        log_weights = log_weights + np.log(born)[..., None]
        if state:
            old_states, old_modes, favour = self._moved(state, frame.shape, rng)
            old = state_log_ratio(self.sensor, frame, old_states)
            absent = absent + stays * np.mean((old == -np.inf) * np.exp(favour), axis=-1)
            old += np.log(stays / self.particles)[..., None] + favour
            states = np.concatenate([states, old_states], axis=-2)
            modes = np.concatenate([modes, old_modes], axis=-1)
            log_weights = np.concatenate([log_weights, old], axis=-1)
        log_weights, mass = normalise(log_weights)
        log_odds = mass - np.log(absent)
        chosen = systematic_resample(log_weights, self.particles, rng)
        cloud = Cloud(
            pick(states, chosen), pick(modes, chosen), log_odds, number)
        return cloud, declare_posterior(
            log_odds, self.threshold,
            lambda found: weighted_moments(states[found], log_weights[found]))

    def _moved(
        self, state: Cloud, shape: tuple[int, ...], rng: np.random.Generator,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | float]:
        """Return states, modes and log weights of the continuing cloud, before the frame."""
        period, number = self.sensor.frame_period_s, state.frame + 1
        modes = self.motion.switch(state.modes, period, rng)
        if not self.destination.is_ahead(number):
            return self.motion.move(state.states, modes, period, rng), modes, 0.0
        states, favour = move_towards(
            self.destination, self.motion, state.states, modes, number, period,
            _area_m2(self.sensor, shape), rng)
        return states, modes, favour

    def _births(
        self, number: int, frame: np.ndarray, rng: np.random.Generator,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return states, modes and log weights of the birth cloud, before P_b."""
        proposal = log_birth_proposal(self.sensor.log_likelihood_ratio(frame))
        cells = systematic_resample(proposal, self.birth_particles, rng)
        states, modes = draw_births(cells, frame.shape[-1], self.sensor, self.motion, rng)
        correction = -np.log(proposal.shape[-1] * self.birth_particles) - pick(proposal, cells)
        if self.destination.is_ahead(number):
            correction += np.log(favour_of_states(
                self.destination, states, number, self.sensor.frame_period_s,
                _area_m2(self.sensor, frame.shape)))
        return states, modes, state_log_ratio(self.sensor, frame, states) + correction


def _area_m2(sensor: SensorModel, shape: tuple[int, ...]) -> float:
    """Return the area of a frame (..., rows, cols)."""
    return shape[-2] * shape[-1] * sensor.cell_size_m**2


@register('tbd2')
@dataclass(frozen=True, kw_only=True)
class TBD2(MMTBD2):
    """The same with one mode: constant velocity."""

    motion: ConstantVelocity = field(default_factory=ConstantVelocity)
