# SPDX-License-Identifier: Apache-2.0
"""
Motion to a destination: the conditionally Markov sequence that Section VII of the paper proposes.

The base motion is ``x_{k+1} = F x_k + w_k``, ``w_k ~ N(0, Q)``.  The destination d says where the
object is in frame N, its velocity left open: ``d = H x_N + r``, ``r ~ N(0, s^2 I)``.  Given d the
motion is a CM_L sequence (Rezaie and Li, "CM sequence based trajectory modeling with destination",
arXiv 1811.08021, there for s = 0 and a whole state d)::

    x_{k+1} = G_{k+1,k} x_k + G_{k+1,N} d + e_{k+1}
    G_{k+1,N} = Q A' (A Q A' + R)^-1,    A = H F^(N-k-1)
    G_{k+1,k} = F - G_{k+1,N} A F,       R = s^2 I + H C_{N|k+1} H'
    Cov(e_{k+1}) = Q - G_{k+1,N} A Q,    C_{N|k} = sum_{n<N-k} F^n Q (F^n)'

and the likelihood of a state x_k is ``p(d | x_k) = N(d; H F^(N-k) x_k, R_k)``.

Note: the destination need not be right.  An object is bound for it with probability p; for an
object that is not, d is uniform in the frame, of area B.  The likelihood of a state, relative to
that of an object that is not bound for d, is then the arrival likelihood
``h_k(x) = 1 - p + p B N(d; H F^(N-k) x, R_k)``, which is never zero.  After frame N the motion is
the base motion again, whether or not the object has stopped there.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace

from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import process_noise_cov
from lowsnr_common.core.motion import VEL
from lowsnr_common.core.streams import standard_normal
from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import setting
import numpy as np


@dataclass(frozen=True, kw_only=True)
class Destination:
    """Where objects are bound for, when they arrive, and how uncertain that is."""

    probability: float = setting(
        0.0, 'probability that an object is bound for the destination, 0 for no destination',
        ge=0.0, lt=1.0)
    x_m: float = setting(0.0, 'position of the destination along the columns [m]')
    y_m: float = setting(0.0, 'position of the destination along the rows, down [m]')
    std_m: float = setting(
        1.0, 'standard deviation of the destination, in each direction [m]', gt=0.0)
    arrival_frame: int = setting(
        40, 'frame of the arrival, counted from the first that the detector gets', ge=1)
    acceleration_density: float = setting(
        0.01, 'process noise up to the arrival, turns included: spectral density of acceleration '
        'per axis [m^2/s^3]', ge=0.0)

    def __post_init__(self) -> None:
        check_settings(self)

    def is_ahead(self, frame: int) -> bool:
        """Return whether there is a destination and a frame is not after the arrival."""
        return self.probability > 0.0 and frame <= self.arrival_frame

    def moved(self, by: tuple[int, int], cell_size_m: float) -> Destination:
        """Return it in cells whose first one moved ``by`` rows and columns."""
        rows, cols = by
        return replace(
            self, x_m=self.x_m - cols * cell_size_m, y_m=self.y_m - rows * cell_size_m)

    def look_ahead(self, frame: int, period_s: float) -> tuple[float, float]:
        """Return the time from a frame to the arrival [s] and the variance R there [m^2]."""
        left_s = (self.arrival_frame - frame) * period_s
        return left_s, self.std_m**2 + self.acceleration_density * left_s**3 / 3.0

    def arrival_likelihood(
        self, position_m: np.ndarray, variance_m2: np.ndarray | float, area_m2: float,
    ) -> np.ndarray:
        """
        Return h, the likelihood of the destination given the position at the arrival.

        Parameters
        ----------
        position_m : (..., 2) ndarray
            Expected position x, y at the arrival [m].
        variance_m2 : (..., 2) ndarray or float
            Variance of the destination about it, in each direction [m^2].
        area_m2
            Area of the frame [m^2].

        Returns
        -------
        (...,) ndarray
            Relative to an object that is not bound for it; at least ``1 - probability``.

        """
        variance = np.broadcast_to(variance_m2, position_m.shape)
        square = np.sum((position_m - (self.x_m, self.y_m))**2 / variance, axis=-1)
        density = np.exp(-0.5 * square) / (2.0 * np.pi * np.sqrt(variance.prod(axis=-1)))
        return np.asarray(1.0 - self.probability + self.probability * area_m2 * density)


def bridge_gain(
    destination: Destination, density: float, frame: int, period_s: float,
) -> tuple[np.ndarray, float]:
    """
    Return ``G_{k+1,N}`` of a step of the base motion, which is the same for both axes.

    Parameters
    ----------
    destination
        Destination of the step.
    density
        Process noise of the step [m^2/s^3].
    frame
        Frame k + 1 that the step leads to, up to the arrival.
    period_s
        Time step [s].

    Returns
    -------
    (2,) ndarray
        Gain of position and velocity on the distance that is left to the destination [1, 1/s].
    float
        Variance ``A Q A' + R`` of the destination given the state before the step [m^2].

    """
    left_s, variance = destination.look_ahead(frame, period_s)
    ahead = np.array([1.0, left_s])
    cross = process_noise_cov(period_s, density)[:2, :2] @ ahead
    total = float(ahead @ cross + variance)
    return cross / total, total


def move_towards(
    destination: Destination, motion: MotionModes, states: np.ndarray, modes: np.ndarray,
    frame: int, period_s: float, area_m2: float, rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Draw x_{k+1} given x_k, the mode r_{k+1} and the destination.

    The motion after the step is taken to be straight, with the process noise of the destination.
    The weight is the ratio of the arrival likelihoods after and before the step, so that it
    accounts for turns.  The weight of a birth is ``h(x)`` (:func:`state_likelihood`).

    Parameters
    ----------
    destination
        Where objects are bound for.
    motion
        Base motion.
    states : (..., N, 4) ndarray
        States x_k [m, m/s].
    modes : (..., N) ndarray of int
        Modes that govern the step.
    frame
        Frame k + 1, up to the arrival.
    period_s
        Time step [s].
    area_m2
        Area of the frame [m^2].
    rng
        Source of randomness.

    Returns
    -------
    (..., N, 4) ndarray
        States x_{k+1}.
    (..., N) ndarray
        Log weight, zero for straight motion with the process noise of the destination [nat].

    """
    left_s, variance = destination.look_ahead(frame, period_s)
    gain, total = bridge_gain(destination, motion.acceleration_density, frame, period_s)
    turned = np.einsum(
        '...ij,...j->...i', motion.transition_matrices(period_s)[modes], states)
    after = destination.arrival_likelihood(
        turned[..., POS] + left_s * turned[..., VEL], total, area_m2)
    moved = motion.move(states, modes, period_s, rng)
    # A draw of the base motion and one of the destination, corrected by the distance between
    # them, is a draw of the motion given the destination.
    missing = (
        np.array([destination.x_m, destination.y_m])
        + np.sqrt(variance) * standard_normal((*modes.shape, 2), rng)
        - moved[..., POS] - left_s * moved[..., VEL])
    bound = after * rng.random(modes.shape) >= 1.0 - destination.probability
    missing *= bound[..., None]
    moved[..., POS] += gain[0] * missing
    moved[..., VEL] += gain[1] * missing
    before = state_likelihood(destination, states, frame - 1, period_s, area_m2)
    return moved, np.log(after / before)


def state_likelihood(
    destination: Destination, states: np.ndarray, frame: int, period_s: float, area_m2: float,
) -> np.ndarray:
    """Return the arrival likelihood h_k of states (..., 4) in a frame k up to the arrival."""
    left_s, variance = destination.look_ahead(frame, period_s)
    return destination.arrival_likelihood(
        states[..., POS] + left_s * states[..., VEL], variance, area_m2)
