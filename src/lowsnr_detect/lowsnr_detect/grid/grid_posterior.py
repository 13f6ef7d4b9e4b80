# SPDX-License-Identifier: Apache-2.0
"""Where the one object of a filter on a grid of states is: the posterior in some cells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from lowsnr_detect.parts.local_estimate import grid_moments
from lowsnr_detect.parts.local_estimate import Posterior
from lowsnr_detect.parts.local_estimate import windows
import numpy as np


@dataclass(frozen=True)
class GridBelief:
    """
    The probability of every state, in proportion: ``scale * planes``.

    Parameters
    ----------
    planes : (C, ..., R rows, R cols) ndarray
        Factor of each class and point.
    scale : (..., R rows, R cols) ndarray
        Factor of each point.
    velocity : (C, 2) ndarray
        Mean v_x, v_y of each class [m/s].
    velocity_cov : (C, 2, 2) ndarray
        Its covariance.
    cell_size_m
        Side of a cell [m].
    resolution
        Points R per cell and axis.

    """

    planes: np.ndarray
    scale: np.ndarray
    velocity: np.ndarray
    velocity_cov: np.ndarray
    cell_size_m: float
    resolution: int = 1

    def posterior(
        self, mass: Callable[[np.ndarray], np.ndarray], likelihood: np.ndarray | None,
        peak: np.ndarray,
    ) -> Posterior:
        """
        Return where the object is.

        Parameters
        ----------
        mass
            Takes which runs, (...,) of bool, and returns the probability of their points.
        likelihood : (..., R rows, R cols) ndarray or None
            Likelihood of the frame in each point, divided by its largest value; None where the
            belief is not the prediction of the frame before, weighed by this frame.
        peak : (...,) ndarray
            Log of that value [nat].

        """
        def moments(runs: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return self._moments(self._joint(runs, cells), cells)

        def before(
            runs: np.ndarray, cells: np.ndarray,
        ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            after = self._joint(runs, cells)
            weight = _near(np.asarray(likelihood)[None], runs, cells, self.resolution)
            prior = np.divide(after, weight, out=np.zeros_like(after), where=weight > 0.0)
            ratio = after.sum(axis=(1, 2, 3)) / prior.sum(axis=(1, 2, 3))
            return np.log(ratio) + peak[runs], *self._moments(prior, cells)

        return Posterior(
            mass, moments, self.cell_size_m, self.resolution,
            None if likelihood is None else before)

    def _joint(self, runs: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """Return the probability of the states in 3 x 3 cells, (n, C, 3 R, 3 R)."""
        return np.asarray(_near(self.planes, runs, cells, self.resolution) * _near(
            self.scale[None], runs, cells, self.resolution))

    def _moments(self, joint: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return grid_moments(
            joint, cells, self.velocity, self.velocity_cov, self.cell_size_m)


def _near(
    planes: np.ndarray, runs: np.ndarray, cells: np.ndarray, resolution: int,
) -> np.ndarray:
    """Return the values in the 3 x 3 cells around one of each of some runs."""
    return windows(planes[:, runs], np.arange(len(cells)), cells, resolution)
