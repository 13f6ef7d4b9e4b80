# SPDX-License-Identifier: Apache-2.0
"""
Prediction on a grid of states: classes of velocities times points of the frame.

A state is a class and a point; from a frame to the next it goes to another class and by a step
of whole points to another point.  The mass of the states after a frame is held in two arrays,
``planes`` (C, ..., rows, cols) of each class and point, and ``scale`` (..., rows, cols), a
factor of every point: a frame weighs all classes of a point alike, and so touches ``scale``
alone.
"""

from __future__ import annotations

from dataclasses import dataclass
import functools

from lowsnr_common.images.bands import in_bands
from lowsnr_detect.grid import transition_kernels
import numpy as np


@dataclass(frozen=True, eq=False)
class Transitions:
    """
    Sparse probabilities of the transitions between classes, with their steps.

    Transitions into the same class with the same step are a group; ``first_group`` and
    ``first_entry`` say where the groups of a class and the entries of a group begin.  The mode
    of a class switches first, whatever its velocity; classes of a mode follow one another.

    Parameters
    ----------
    first_group : (C + 1,) ndarray of int
        By class after the step.
    step : (G, 2) ndarray of int
        Rows and columns, in points.
    first_entry : (G + 1,) ndarray of int
        By group.
    source : (E,) ndarray of int
        Class before the step, after its mode has switched.
    prob : (E,) ndarray
        Probability given the source; they sum to one for each source.
    switch : (M, M) ndarray
        Probability of a mode given the one before, which is the row.
    appears : (C,) ndarray
        Probability of the class of an object that appears.
    velocity : (C, 2) ndarray
        Mean v_x, v_y of each class [m/s].
    velocity_cov : (C, 2, 2) ndarray
        Its covariance.

    """

    first_group: np.ndarray
    step: np.ndarray
    first_entry: np.ndarray
    source: np.ndarray
    prob: np.ndarray
    switch: np.ndarray
    appears: np.ndarray
    velocity: np.ndarray
    velocity_cov: np.ndarray

    @property
    def count(self) -> int:
        """Return the number of classes."""
        return len(self.appears)


def grouped(
    source: np.ndarray, target: np.ndarray, step: np.ndarray, prob: np.ndarray, count: int,
) -> dict[str, np.ndarray]:
    """
    Return the first five arrays of :class:`Transitions`.

    Parameters
    ----------
    source, target : (E,) ndarray of int
        Class before and after the step.
    step : (E, 2) ndarray of int
        Rows and columns.
    prob : (E,) ndarray
        Probabilities, in proportion for each source.
    count
        Number of classes C.

    """
    order = np.lexsort((source, step[:, 1], step[:, 0], target))
    source, target, step, prob = source[order], target[order], step[order], prob[order]
    key = np.column_stack([target, step])
    begins = np.flatnonzero(np.r_[True, np.any(np.diff(key, axis=0), axis=1)])
    sums = np.bincount(source, weights=prob, minlength=count)
    return {
        'first_group': np.searchsorted(target[begins], np.arange(count + 1)),
        'step': step[begins], 'first_entry': np.r_[begins, len(source)], 'source': source,
        'prob': prob / sums[source]}


def predict(
    transitions: Transitions, planes: np.ndarray, scale: np.ndarray, stays: np.ndarray,
    born: np.ndarray, regions: int = 1,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Advance the mass of all states by a frame, ``stays T (scale planes) + born appears``.

    Parameters
    ----------
    transitions
        Probabilities T.
    planes : (C, ..., rows, cols) ndarray
        Mass of each class and point, before ``scale``.
    scale : (..., rows, cols) ndarray
        Factor of each point.
    stays : (...,) ndarray
        Factor of what was there.
    born : (...,) ndarray
        Mass that appears in every point.
    regions
        Sub-regions that are processed in parallel.

    Returns
    -------
    (C, ..., rows, cols) ndarray
        Mass of each class and point; what leaves the frame is gone.
    (..., rows, cols) ndarray
        Its sum over the classes.

    """
    batch, (rows, cols) = scale.shape[:-2], scale.shape[-2:]
    count = transitions.count
    before = np.ascontiguousarray(planes).reshape(count, -1, rows, cols)
    factors = np.ascontiguousarray(scale).reshape(-1, rows, cols)
    survives = np.array(np.broadcast_to(stays, batch)).ravel()
    births = np.outer(transitions.appears, np.broadcast_to(born, batch))
    after, mass = np.empty_like(before), np.empty_like(factors)
    in_bands(
        lambda first, last: transition_kernels.predict(
            before, factors, transitions.first_group, transitions.step, transitions.first_entry,
            transitions.source, transitions.prob, transitions.switch, survives, births, first,
            last, after, mass),
        rows, regions)
    return after.reshape(count, *scale.shape), mass.reshape(scale.shape)


@functools.lru_cache(maxsize=4)
def inside(transitions: Transitions, shape: tuple[int, int], regions: int = 1) -> np.ndarray:
    """Return the probability of a step inside the frame from each class and point, (C, ...)."""
    found = expect(transitions, np.ones((transitions.count, *shape)), regions)
    found.flags.writeable = False
    return found


def expect(transitions: Transitions, values: np.ndarray, regions: int = 1) -> np.ndarray:
    """
    Return the expectation of a value after a step given the state before it, ``T' values``.

    It is the adjoint of :func:`predict`.

    Parameters
    ----------
    transitions
        Probabilities T.
    values : (C, ..., rows, cols) ndarray
        Value of each class and point after the step; zero outside the frame.
    regions
        Sub-regions that are processed in parallel.

    Returns
    -------
    (C, ..., rows, cols) ndarray
        Its expectation for each class and point before the step.

    """
    rows, cols = values.shape[-2:]
    after = np.ascontiguousarray(values).reshape(transitions.count, -1, rows, cols)
    before = np.empty_like(after)
    in_bands(
        lambda first, last: transition_kernels.expect(
            after, transitions.first_group, transitions.step, transitions.first_entry,
            transitions.source, transitions.prob, transitions.switch, first, last, before),
        rows, regions)
    return before.reshape(values.shape)
