# SPDX-License-Identifier: Apache-2.0
"""
The belief of HMM, and its steps: of the base motion, or to destinations.

To one destination, on which the origin depends, moves have the probabilities of
:mod:`lowsnr_detect.parts.destination_moves`; to several they are those of
:mod:`lowsnr_detect.grid.bound_steps`.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace
import functools

from lowsnr_common.core.bound_motion import Destinations
from lowsnr_common.core.destination import Destination
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_detect.grid.bound_steps import folded
from lowsnr_detect.grid.bound_steps import Pairs
from lowsnr_detect.grid.bound_steps import pairs
from lowsnr_detect.grid.bound_steps import StateGrid
from lowsnr_detect.grid.bound_steps import Tilt
from lowsnr_detect.grid.bound_steps import tilts
from lowsnr_detect.grid.bound_steps import unfolded
from lowsnr_detect.grid.grid_filter import as_plane
from lowsnr_detect.grid.grid_filter import birth_belief
from lowsnr_detect.grid.grid_filter import expect_belief
from lowsnr_detect.grid.grid_filter import move_and_weigh
from lowsnr_detect.grid.grid_filter import over_runs
from lowsnr_detect.grid.grid_filter import total
from lowsnr_detect.parts.destination_moves import cell_likelihoods
from lowsnr_detect.parts.destination_moves import move_likelihoods
from lowsnr_detect.parts.moves import move_model
from lowsnr_detect.parts.moves import MoveModel
from lowsnr_detect.parts.moves import shifted
import numpy as np


@dataclass(frozen=True)
class Belief:
    """
    The posterior after a frame.

    Parameters
    ----------
    weights : (dropped, kept, 1 + n, ..., rows, cols) ndarray
        a_k of objects bound for none and of each pair ahead, in proportion to g_k, with sum
        ``mass``.
    mass : (...,) ndarray
        Sum of the weights.
    log_odds : (...,) ndarray
        Log odds of existence [nat].
    likelihood : (..., rows, cols) ndarray
        l_k, divided by its largest value.
    peak : (...,) ndarray
        Log of that value [nat].
    frame
        Number of the frame, from 1.
    shift
        Rows and columns by which the first cell has moved in the scene.

    """

    weights: np.ndarray
    mass: np.ndarray
    log_odds: np.ndarray
    likelihood: np.ndarray
    peak: np.ndarray
    frame: int
    shift: tuple[int, int] = (0, 0)

    @property
    def given(self) -> np.ndarray:
        """Probability g_k of history, pair and cell given existence, as the weights."""
        return np.asarray(self.weights / as_plane(self.mass))

    def moved(self, by: tuple[int, int], cell_size_m: float) -> Belief:
        """Return the belief in cells whose first one moved ``by`` rows and columns."""
        step = np.negative(by)
        return replace(
            self, weights=shifted(self.weights, step, 0.0),
            likelihood=shifted(self.likelihood, step, 0.0),
            shift=(self.shift[0] + by[0], self.shift[1] + by[1]))


@dataclass(frozen=True)
class MoveSteps:
    """Steps into a frame, of objects with a motion that are bound for destinations."""

    motion: MotionModes
    sensor: SensorModel
    order: int
    destination: Destination
    destinations: Destinations
    regions: int = 1

    @functools.cached_property
    def model(self) -> MoveModel:
        """Return the probabilities of the moves of the base motion."""
        return move_model(self.motion, self.sensor, self.order)

    @functools.cached_property
    def pairs(self) -> Pairs:
        """Return what objects may be bound for."""
        return pairs(self.destinations)

    def vary(self, number: int) -> bool:
        """Return whether the steps into a frame differ from those into others."""
        return self.destination.is_ahead(number) or self.pairs.ahead(number) > 0

    def births(
        self, number: int, shape: tuple[int, ...], shift: tuple[int, int],
    ) -> np.ndarray:
        """Return b(x) in a frame of a shape, with the axes of the weights of a belief."""
        shares = self.pairs.shares(number)
        uniform = birth_belief(self.model, (1, *shape))
        births = np.asarray(uniform * shares.reshape(-1, *[1] * len(shape)))
        if not self.destination.is_ahead(number):
            return births
        rows, cols = shape[-2:]
        factor = cell_likelihoods(
            self._destination(shift), self.motion, self.sensor, self.order, number, (rows, cols))
        return np.asarray(births * over_runs(factor, len(shape) - 1))

    def forward(
        self, last: Belief, likelihood: np.ndarray, stays: np.ndarray, born: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return a_k, inside_k and the sum of a_k, for (1 - P_d) p_{k-1} and the births."""
        number, scale = last.frame + 1, 1.0 / last.mass
        if self.vary(number):
            moved = self._moved(last, likelihood.shape) * as_plane(scale)
            births = self.births(number, likelihood.shape, last.shift)
            weights = likelihood * (as_plane(stays) * moved + as_plane(born) * births)
            return weights, total(moved).sum(axis=0), total(weights).sum(axis=0)
        weights, inside, mass = move_and_weigh(
            self.model, self._as_belief(folded(self._by_state(last.weights), 1)),
            likelihood[None], stays * scale, born, regions=self.regions)
        return weights, inside[0] * scale, mass[0]

    def expected(self, number: int, value: np.ndarray, shift: tuple[int, int]) -> np.ndarray:
        """Return ``sum_y P(y | x) value(y)`` for the moves into a frame."""
        if value.shape[2] > 1:
            found = self._tilt(number, value.shape[3:], shift).expected(
                self._expect, self._by_state(value))
            return self._as_belief(found)
        if not self.destination.is_ahead(number):
            return expect_belief(self.model, value)
        factor, mean = self._one_destination(number, value.shape, shift)
        expected = expect_belief(self.model, value, factor)
        return np.asarray(expected / over_runs(mean, value.ndim - 4))

    def before(self, ratio: np.ndarray, number: int) -> np.ndarray:
        """Return a ratio for what objects may be bound for before the step into a frame."""
        return self._as_belief(unfolded(
            self._by_state(ratio), 1 + self.pairs.ahead(number - 1)))

    def _moved(self, last: Belief, shape: tuple[int, ...]) -> np.ndarray:
        """Return the weights of a belief after the step towards destinations."""
        number = last.frame + 1
        if self.pairs.ahead(number) == 0:
            factor, mean = self._one_destination(number, shape, last.shift)
            return self._move(last.weights / over_runs(mean, last.weights.ndim - 4), factor)
        mass = folded(self._by_state(last.weights), 1 + self.pairs.ahead(number))
        return self._as_belief(self._tilt(number, shape, last.shift).moved(
            lambda mass: self._by_state(self._move(self._as_belief(mass))), mass))

    def _move(self, belief: np.ndarray, factor: np.ndarray | None = None) -> np.ndarray:
        """Return a belief after the moves, each with a factor, and not weighed."""
        ones, nothing = np.ones(belief.shape[2:]), np.array(0.0)
        return move_and_weigh(
            self.model, belief, ones, np.array(1.0), nothing, factor, self.regions)[0]

    def _destination(self, shift: tuple[int, int]) -> Destination:
        return self.destination.moved(shift, self.sensor.cell_size_m)

    def _one_destination(
        self, number: int, shape: tuple[int, ...], shift: tuple[int, int],
    ) -> tuple[np.ndarray, np.ndarray]:
        rows, cols = shape[-2:]
        return move_likelihoods(
            self._destination(shift), self.motion, self.sensor, self.order, number, (rows, cols))

    def _tilt(self, number: int, shape: tuple[int, ...], shift: tuple[int, int]) -> Tilt:
        model = self.model
        return tilts(self.pairs, StateGrid(
            model.velocity.reshape(-1, 2), model.velocity_cov.reshape(-1, 2, 2), self.sensor,
            self.motion.acceleration_density, int(abs(model.moves).max()), self._expect),
            number, shape, shift)

    def _expect(self, values: np.ndarray) -> np.ndarray:
        return self._by_state(expect_belief(self.model, self._as_belief(values)))

    def _by_state(self, belief: np.ndarray) -> np.ndarray:
        """Return (dropped, kept, ...) as (C, ...)."""
        return belief.reshape(-1, *belief.shape[2:])

    def _as_belief(self, values: np.ndarray) -> np.ndarray:
        """Return (C, ...) as (dropped, kept, ...)."""
        return values.reshape(*self.model.history.shape, *values.shape[1:])
