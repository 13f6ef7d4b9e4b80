# SPDX-License-Identifier: Apache-2.0
"""
Object motion, Section II of the paper: eq. (1), several modes, Markov switching.

A state is ``[p_x, v_x, p_y, v_y]`` in metres and metres a second.  A mode is a turn
rate: zero is the constant-velocity model of eq. (1), any other value a coordinated
turn.  Modes switch first, then states move: the mode r_k drawn from r_(k-1) governs
the step from x_(k-1) to x_k.
"""

from __future__ import annotations

from dataclasses import dataclass
import functools

from lowsnr_common.core.particle_kernels import move_states
from lowsnr_common.core.particle_kernels import switch_modes
from lowsnr_common.core.streams import standard_normal
from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import setting
import numpy as np

POS = [0, 2]
VEL = [1, 3]


def transition_matrix(dt: float, turn_rate: float = 0.0) -> np.ndarray:
    """
    Return F of eq. (1), or of a coordinated turn.

    Parameters
    ----------
    dt
        Time step T [s].
    turn_rate
        Angle the velocity turns in a second [rad/s]; 0 gives eq. (1).  Positive
        turns from x towards y, which is clockwise on a display whose y points down.

    Returns
    -------
    (4, 4) ndarray
        Transition matrix (Bar-Shalom, Li and Kirubarajan 2001, eq. 11.7.1-4).

    """
    angle = turn_rate * dt
    # sin(a)/w and (1 - cos a)/w, written so that w = 0 needs no special case.
    along = dt * np.sinc(angle / np.pi)
    across = dt * np.sin(angle / 2) * np.sinc(angle / (2 * np.pi))
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([
        [1.0, along, 0.0, -across],
        [0.0, cos, 0.0, -sin],
        [0.0, across, 1.0, along],
        [0.0, sin, 0.0, cos],
    ])


def process_noise_cov(dt: float, density: float) -> np.ndarray:
    """
    Return Q, the covariance of v_k in eq. (1), for white-noise acceleration.

    Parameters
    ----------
    dt
        Time step [s].
    density
        Power spectral density of the acceleration, per axis [m^2/s^3].

    Returns
    -------
    (4, 4) ndarray
        Covariance (Bar-Shalom, Li and Kirubarajan 2001, eq. 6.2.2-4).

    """
    axis = density * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    return np.kron(np.eye(2), axis)


def process_noise_sqrt(dt: float, density: float) -> np.ndarray:
    """Return the lower Cholesky factor of Q, (4, 4); zero for no noise."""
    return _noise_sqrt(dt, density).copy()


# Most steps are as long as the one before.
@functools.lru_cache(maxsize=64)
def _noise_sqrt(dt: float, density: float) -> np.ndarray:
    if dt == 0.0 or density == 0.0:
        return np.zeros((4, 4))
    return np.linalg.cholesky(process_noise_cov(dt, density))


@functools.lru_cache(maxsize=64)
def _transition_matrices(turn_rates_deg_s: tuple[float, ...], dt: float) -> np.ndarray:
    return np.stack([transition_matrix(dt, np.deg2rad(w)) for w in turn_rates_deg_s])


@dataclass(frozen=True, kw_only=True)
class MotionModes:
    """
    A set of motion modes and the Markov chain that switches between them.

    The mode follows a continuous-time Markov chain that leaves it at a constant rate, for
    each of the other modes alike, so that uneven time steps are treated consistently.
    """

    turn_rates_deg_s: tuple[float, ...] = setting(
        (0.0, 20.0, -20.0), 'turn rate of each mode, 0 for constant velocity [deg/s]',
        ge=-36_000.0, le=36_000.0)
    mode_sojourn_s: float = setting(
        10.0, 'mean time in a mode before it switches to another [s]', gt=0.0)
    acceleration_density: float = setting(
        0.001, 'process noise: spectral density of acceleration per axis [m^2/s^3]', ge=0.0)
    min_speed_mps: float = setting(0.0, 'lowest speed an object may appear with [m/s]', ge=0.0)
    max_speed_mps: float = setting(1.0, 'highest speed an object may appear with [m/s]', gt=0.0)

    def __post_init__(self) -> None:
        check_settings(self)
        if not self.turn_rates_deg_s:
            raise ValueError('MotionModes.turn_rates_deg_s is empty, must hold at least one mode')
        if self.min_speed_mps > self.max_speed_mps:
            raise ValueError(
                f'MotionModes.min_speed_mps = {self.min_speed_mps}, must be at most '
                f'max_speed_mps = {self.max_speed_mps}')

    @property
    def count(self) -> int:
        """Return the number of modes."""
        return len(self.turn_rates_deg_s)

    def single(self) -> MotionModes:
        """Return the same motion with constant velocity as the only mode."""
        return MotionModes(
            turn_rates_deg_s=(0.0,), mode_sojourn_s=self.mode_sojourn_s,
            acceleration_density=self.acceleration_density,
            min_speed_mps=self.min_speed_mps, max_speed_mps=self.max_speed_mps)

    def transition_matrices(self, dt: float) -> np.ndarray:
        """Return F of every mode for a step of dt [s], (modes, 4, 4)."""
        return _transition_matrices(self.turn_rates_deg_s, dt).copy()

    def mode_transition(self, dt: float) -> np.ndarray:
        """
        Return the mode transition probabilities over a step of dt [s].

        Returns
        -------
        (modes, modes) ndarray
            Row = mode before, column = mode after; rows sum to one.

        """
        if self.count == 1:
            return np.ones((1, 1))
        # Closed form of expm(rate * generator) for equal off-diagonal rates.
        decay = np.exp(-dt / self.mode_sojourn_s * self.count / (self.count - 1))
        transition: np.ndarray = decay * np.eye(self.count) + (1.0 - decay) / self.count
        return transition

    def switch(self, modes: np.ndarray, dt: float, rng: np.random.Generator) -> np.ndarray:
        """
        Draw r_k given r_(k-1).

        Parameters
        ----------
        modes : (..., N) ndarray of int
            Mode indices before the step.
        dt
            Time step [s].
        rng
            Source of randomness.

        Returns
        -------
        (..., N) ndarray of int
            Mode indices after the step.

        """
        if self.count == 1:
            return modes
        cumulative = np.cumsum(self.mode_transition(dt), axis=1)[:, :-1]
        draw = rng.random(modes.shape).ravel()
        after: np.ndarray = switch_modes(modes.ravel(), draw, cumulative)
        return after.reshape(modes.shape)

    def move(
        self, states: np.ndarray, modes: np.ndarray, dt: float, rng: np.random.Generator,
    ) -> np.ndarray:
        """
        Draw x_k given x_(k-1) and r_k: ``x_k = F(r_k) x_(k-1) + v_k``.

        Parameters
        ----------
        states : (..., N, 4) ndarray
            States before the step.
        modes : (..., N) ndarray of int
            Modes that govern the step.
        dt
            Time step [s].
        rng
            Source of randomness.

        Returns
        -------
        (..., N, 4) ndarray
            States after the step.

        """
        after: np.ndarray = standard_normal(states.shape, rng)
        factor = process_noise_sqrt(dt, self.acceleration_density)
        move_states(
            np.ascontiguousarray(states).reshape(-1, 4), modes.ravel(),
            self.transition_matrices(dt), factor, after.reshape(-1, 4))
        return after

    def draw_velocity(self, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
        """
        Draw velocities, uniform in direction and in speed between its limits.

        Returns
        -------
        (..., 2) ndarray
            v_x, v_y [m/s] for the given leading shape.

        """
        speed = rng.uniform(self.min_speed_mps, self.max_speed_mps, shape)
        heading = rng.uniform(-np.pi, np.pi, shape)
        velocity = np.empty((*shape, 2))
        np.multiply(speed, np.cos(heading), out=velocity[..., 0])
        np.multiply(speed, np.sin(heading), out=velocity[..., 1])
        return velocity
