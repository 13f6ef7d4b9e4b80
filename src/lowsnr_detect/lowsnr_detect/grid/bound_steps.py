# SPDX-License-Identifier: Apache-2.0
"""
Steps on a grid of states of objects that are each bound for one of several destinations.

As in :mod:`lowsnr_common.core.bound_motion` an object carries from its birth on a pair h of a
destination and the frame N of its arrival, or none.  The state of the grid is extended by it.
With T(x | y) the probability of a step of the base motion, from y to x in frame k, a point p
and a velocity v for every state x, and q the process noise, the step of a pair is ::

    T_h(x | y) = T(x | y) L_h(x) / M_h(y),      M_h(y) = sum_x T(x | y) L_h(x)
    L_h(x) = N(d; p + t v, s^2 + q t^3 / 3 + var p + t^2 var v),      t = (N - k) period

where d and s are mean and standard deviation of the place, and the variances those of the
objects that a state stands for, in each direction.  M_h sums over steps out of the frame too, so
that a pair changes where an object goes but not whether it survives.  After frame N the steps
are those of the base motion: the mass of the pair is added to that of objects bound for none,
exactly, and the pair costs no more time.

Note: the place is not drawn at the birth but has its density in every step, so that p(x_N) is in
proportion to what the base motion reaches times the density of the place.  For s = 0 both are the
same; a wide place can be given as several narrow ones.  Where no step reaches the destination any
more, that is, L_h underflows, the steps are those of the base motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import functools

from lowsnr_common.core.bound_motion import Bound
from lowsnr_common.core.bound_motion import Destinations
from lowsnr_common.core.measurement import SensorModel
import numpy as np

# Least log density along an axis, from which M_h is still above zero.
_LEAST_LOG = -300.0


@dataclass(frozen=True, eq=False)
class Pairs:
    """
    The pairs of a destination and a frame of arrival, those that arrive last first.

    Parameters
    ----------
    prob : (n,) ndarray
        Probability of each; the rest to one is bound for none.
    bound : Bound of (n,)
        Mean of its place, and its frame.
    std_m : (n,) ndarray
        Standard deviation of its place in each direction [m].

    """

    prob: np.ndarray
    bound: Bound
    std_m: np.ndarray

    def ahead(self, frame: int) -> int:
        """Return how many pairs arrive in a frame or after it: the first ones."""
        return int(np.count_nonzero(self.bound.arrival >= frame))

    def shares(self, frame: int) -> np.ndarray:
        """Return the probability that a birth in a frame is bound for none and each ahead."""
        prob = self.prob[:self.ahead(frame)]
        return np.concatenate([[1.0 - prob.sum()], prob])


def bound_count(destinations: Destinations) -> int:
    """Return what an object may be bound for: none, or one of the pairs, which are not made."""
    return 1 + sum(len(place.arrivals) for place in destinations.densities)


def step_arrays(destinations: Destinations) -> int:
    """Return how many arrays of all states a step makes."""
    # With pairs the factors too, in the frame and beyond it, and the mass divided by them.
    return 7 if destinations.densities else 2


@functools.lru_cache(maxsize=16)
def pairs(destinations: Destinations) -> Pairs:
    """Return the pairs of destinations."""
    each = [(place.probability / len(place.arrivals), place.x_m,
             place.y_m, frame, place.std_m) for place in destinations.densities
            for frame in place.arrivals]
    prob, x_m, y_m, arrival, std_m = np.reshape(
        sorted(each, key=lambda pair: -pair[3]), (-1, 5)).T
    return Pairs(prob, Bound(np.stack([x_m, y_m], axis=-1), arrival.astype(int)), std_m)


@dataclass(frozen=True)
class StateGrid:
    """
    Classes of velocities times the points of a frame, with the steps of the base motion.

    Parameters
    ----------
    velocity : (C, 2) ndarray
        Mean v_x, v_y of each class [m/s].
    velocity_cov : (C, 2, 2) ndarray
        Its covariance.
    sensor
        Cells and frame period.
    density
        Process noise q of the base motion [m^2/s^3].
    reach
        Longest step in rows or columns, in points.
    expect
        Takes values (C, n, ..., rows, cols) after a step, and returns their expectations before
        it; values outside the frame are zero.
    resolution
        Points per cell and axis.

    """

    velocity: np.ndarray
    velocity_cov: np.ndarray
    sensor: SensorModel
    density: float
    reach: int
    expect: Callable[[np.ndarray], np.ndarray]
    resolution: int = 1


@dataclass(frozen=True)
class Tilt:
    """
    L_h and M_h of a frame, (C, 1 + n, ..., rows, cols); one for the objects bound for none.

    The step is ``moved``, and ``expected`` its adjoint.
    """

    likelihood: np.ndarray
    mean: np.ndarray

    def moved(self, move: Callable[[np.ndarray], np.ndarray], mass: np.ndarray) -> np.ndarray:
        """Return the mass (C, 1 + n, ..., rows, cols) that ``move`` of the base motion moves."""
        after = move(mass / self.mean)
        after *= self.likelihood
        return after

    def expected(
        self, expect: Callable[[np.ndarray], np.ndarray], values: np.ndarray,
    ) -> np.ndarray:
        """Return the expectation of values (C, 1 + n, ..., rows, cols) after the step."""
        before = expect(values * self.likelihood)
        before /= self.mean
        return before


def tilts(
    which: Pairs, grid: StateGrid, frame: int, shape: tuple[int, ...], shift: tuple[int, int],
) -> Tilt:
    """
    Return L_h and M_h of the pairs that are ahead.

    Parameters
    ----------
    which
        All pairs.
    grid
        States.
    frame
        Frame k that the step leads to.
    shape
        Points of the frames, (..., rows, cols).
    shift
        Rows and columns by which the first cell has moved in the scene.

    """
    pad, (rows, cols) = grid.reach, shape[-2:]
    across, down = _axis_likelihoods(which, grid, frame, (cols, rows), shift)
    wide = across[..., None, :] * down[..., :, None]
    mean = grid.expect(wide)[..., pad:pad + rows, pad:pad + cols]
    likelihood = wide[..., pad:pad + rows, pad:pad + cols]
    return Tilt(*(_with_none(each, len(shape) - 2) for each in (likelihood, mean)))


def _with_none(factor: np.ndarray, axes: int) -> np.ndarray:
    """Return (C, 1 + n, 1, ..., rows, cols) with one for none, and as many axes of length 1."""
    classes, count, rows, cols = factor.shape
    whole = np.ones((classes, 1 + count, rows, cols))
    whole[:, 1:] = factor
    return whole.reshape(classes, 1 + count, *[1] * axes, rows, cols)


def _axis_likelihoods(
    which: Pairs, grid: StateGrid, frame: int, points: tuple[int, int], shift: tuple[int, int],
) -> list[np.ndarray]:
    """Return the factors (C, n, points + 2 reach) of L_h along the columns and the rows."""
    count, size = which.ahead(frame), grid.sensor.cell_size_m
    bound = which.bound[:count].moved(shift, size)
    left_s = bound.left_s(frame, grid.sensor.frame_period_s)
    spacing = size / grid.resolution
    known = which.std_m[:count]**2 + grid.density * left_s**3 / 3.0 + spacing**2 / 12.0
    factors = []
    for axis, number in enumerate(points):
        place = spacing * (np.arange(-grid.reach, number + grid.reach) + 0.5) - size / 2.0
        variance = known + left_s**2 * grid.velocity_cov[:, axis, axis, None]
        away = (place + (left_s * grid.velocity[:, axis, None] - bound.place[:, axis])[..., None])
        log_density = -0.5 * (away**2 / variance[..., None] + np.log(variance)[..., None])
        # Relative to the largest of all classes, because only ratios of a pair count.
        log_density -= log_density.max(axis=(0, 2), keepdims=True)
        factors.append(np.exp(np.maximum(log_density, _LEAST_LOG)))
    return factors


def folded(mass: np.ndarray, count: int) -> np.ndarray:
    """
    Return the mass of objects bound for none and the first pairs, in all ``count``.

    Parameters
    ----------
    mass : (C, 1 + n, ..., rows, cols) ndarray
        Mass of each pair; that of the pairs that have arrived is added to that of none.
    count
        One and the pairs that are left.

    """
    if count == mass.shape[1]:
        return mass
    kept = mass[:, :count].copy()
    kept[:, 0] += mass[:, count:].sum(axis=1)
    return kept


def unfolded(values: np.ndarray, count: int) -> np.ndarray:
    """Return values (C, 1 + n, ...) for ``count`` pairs: what has arrived is bound for none."""
    if count == values.shape[1]:
        return values
    arrived = values[:, :1].repeat(count - values.shape[1], axis=1)
    return np.concatenate([values, arrived], axis=1)
