# SPDX-License-Identifier: Apache-2.0
"""
Joint decision and estimation: whether to declare, and where, by one expected cost.

With P the probability that there is an object, p(x) the posterior of its place, and k(d) what a
declaration at a distance d from the object is worth, a declaration at y gains ::

    G(y) = sum_x p(x) k(|x - y|),      0 <= G <= P

In units of the cost of a missed object, and with a false declaration that costs lambda, the
three decisions cost ::

    say nothing      P                              the object is missed
    declare at y     P - G(y) + lambda (1 - G(y))   what is not gained is missed, and false
    wait a frame     kappa                          whatever there is

The best place is that of the largest G, whatever lambda is, and it is declared where ::

    ln { [ G - max(P - kappa, 0) ] / (1 - G) }  >  ln lambda

so that the calibration of a threshold to a false-alarm probability sets lambda.  The rules are

- ``gospa``: ``k = 1 - min(d / c, 1)^2``.  With lambda = 1 the cost is the expected GOSPA metric,
  squared, over its cost c^2 / 2 of a miss.
- ``hit``: ``k = 1`` for d <= c, else 0: G is the probability of a hit.
- ``existence``: ``k = 1``: where the object is does not matter, and the mean of its best local
  mode is declared.

Joint decision and estimation by such a risk is due to Li (2007).

Note: Li weighs with lambda the frames without an object alone.  Here it also weighs a
declaration beside the object, which GOSPA counts as false as well; G is then all that matters,
and the rule needs the posterior near y alone.
"""

from __future__ import annotations

from dataclasses import dataclass
import functools
import math

from lowsnr_common.core.motion import POS
from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import setting
from lowsnr_detect.decisions import place_kernels
import numpy as np
import scipy

# Places that are looked at, and parts of a point over which a table is averaged, on each axis of
# a cell and of a point.
_PLACES, _PARTS = 4, 12
# Probability of a hit that is given up for a place in the middle, which is nearer to the object:
# it costs no measurable P_D, and the GOSPA metric of hits is 5 % less than without.
_GIVEN_UP = 0.02


@dataclass(frozen=True, kw_only=True)
class Decision:
    """The cost by which it is decided whether an object is declared, and where."""

    rule: str = setting(
        'existence', "what is declared: 'existence': an object that is probable; 'gospa': the "
        "place with the least expected GOSPA metric; 'hit': the place that is most probably hit",
        choices=('existence', 'gospa', 'hit'))
    cutoff_cells: float = setting(
        1.5, 'distance from an object beyond which a declaration is false, for gospa and hit '
        '[cells]', gt=0.0, le=16.0)
    wait_cost: float = setting(
        1.0, 'cost of waiting for the next frame instead of declaring, as a fraction of that of a '
        'missed object, for gospa and hit; 1 never waits', gt=0.0, le=1.0)

    def __post_init__(self) -> None:
        check_settings(self)
        if self.rule == 'existence' and self.wait_cost < 1.0:
            raise ValueError(
                f"Decision.wait_cost = {self.wait_cost}, must be 1 where rule is 'existence': "
                "set rule to 'gospa' or 'hit'")

    @property
    def places(self) -> bool:
        """Whether the decision depends on the place."""
        return self.rule != 'existence'

    def statistic(self, log_odds: np.ndarray, share: np.ndarray) -> np.ndarray:
        """
        Return the log of the largest lambda at which an object is declared.

        Parameters
        ----------
        log_odds : (...,) ndarray
            Log odds that there is an object [nat].
        share : (...,) ndarray
            Gain of the best place, given that there is one.

        """
        prob = scipy.special.expit(log_odds)
        gain = prob * share - np.maximum(prob - self.wait_cost, 0.0)
        wrong = scipy.special.expit(-np.asarray(log_odds)) + prob * (1.0 - share)
        with np.errstate(divide='ignore'):
            return np.asarray(
                np.log(np.maximum(gain, 0.0))
                - np.log(np.maximum(wrong, np.finfo(float).tiny)))

    def best_places(self, mass: np.ndarray, resolution: int) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the place of the largest gain.

        It is the best of four places per cell and axis.  For ``gospa`` it is then moved to the
        mean of the mass within the cutoff, which never gains less.  For ``hit``, that mean is
        rounded to one of the places, and taken if it gains hardly less: of places that gain the
        same it lies in the middle.  The gain is that of the place that is returned.

        Parameters
        ----------
        mass : (n, R rows, R cols) ndarray
            Probability of each point, in proportion, given that there is an object.
        resolution
            Points R per cell and axis.

        Returns
        -------
        (n, 2) ndarray
            Row and column [cells].
        (n,) ndarray
            Gain, as a fraction of the mass.

        """
        tables = gain_tables(self.rule, self.cutoff_cells, resolution)
        mass = np.ascontiguousarray(mass / mass.sum(axis=(1, 2), keepdims=True))
        places, gains = np.zeros((len(mass), 3), np.intp), np.empty(len(mass))
        place_kernels.best_places(mass, tables, places, gains)
        middle = np.empty((len(mass), 2))
        place_kernels.centres(mass, tables, places, middle)
        if self.rule == 'hit':
            middle, gains = _no_worse(mass, tables, places, gains, middle)
        return (middle + 0.5) / resolution - 0.5, np.minimum(gains, 1.0)


def _no_worse(
    mass: np.ndarray, tables: np.ndarray, places: np.ndarray, gains: np.ndarray,
    middle: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the places at points (n, 2) where they gain hardly less than others, and gains."""
    count = math.isqrt(tables.shape[1])
    point = np.floor(middle + 0.5)
    offset = np.floor((middle + 0.5 - point) * count)
    near = np.column_stack([point, offset @ [count, 1.0]]).astype(np.intp)
    found = np.empty_like(gains)
    place_kernels.gains_at(mass, tables, near, found)
    moved = found >= gains - _GIVEN_UP
    chosen = np.where(moved[:, None], near, places)
    within = np.column_stack(np.divmod(chosen[:, 2], count))
    return chosen[:, :2] + (within + 0.5) / count - 0.5, np.where(moved, found, gains)


@functools.lru_cache(maxsize=16)
def gain_tables(rule: str, cutoff_cells: float, resolution: int) -> np.ndarray:
    """
    Return k, averaged over the points around every place near a point.

    Returns
    -------
    (4, offsets, side, side) ndarray
        As in :func:`lowsnr_detect.decisions.place_kernels.best_places`.

    """
    cutoff = cutoff_cells * resolution
    reach, places = math.ceil(cutoff + 0.5), math.ceil(_PLACES / resolution)
    offset, part = ((np.arange(count) + 0.5) / count - 0.5 for count in (places, _PARTS))
    axis = np.arange(-reach, reach + 1)[:, None] + part
    row, col = axis[:, None, :, None], axis[None, :, None, :]
    tables = []
    for down in offset:
        for across in offset:
            away = ((row - down)**2 + (col - across)**2) / cutoff**2
            inside = away <= 1.0
            gain = inside if rule == 'hit' else np.maximum(1.0 - away, 0.0)
            tables.append([
                np.mean(each, axis=(2, 3)) for each in (gain, inside, inside * row, inside * col)])
    return np.ascontiguousarray(np.moveaxis(np.array(tables), 1, 0))


def declared_at(
    mean: np.ndarray, cov: np.ndarray, place_m: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return estimates at other places: the states, and their second moments about them.

    Parameters
    ----------
    mean, cov : (..., 4) and (..., 4, 4) ndarray
        Means and covariances of states [m, m/s].
    place_m : (..., 2) ndarray
        Row and column of the places that are declared instead [m].

    """
    estimate = mean.copy()
    estimate[..., POS] = place_m[..., ::-1]
    away = mean - estimate
    return estimate, cov + away[..., :, None] * away[..., None, :]
