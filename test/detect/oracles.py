# SPDX-License-Identifier: Apache-2.0
"""Independent references for the detectors: enumeration of all paths."""

from dataclasses import dataclass
import itertools
import math

import numpy as np


@dataclass(frozen=True)
class Trajectories:
    """
    All trajectories of an object from the frame it appears in, or a random sample of them.

    ``positions`` (S, K, 2) are columns and rows in cells, ``weights`` (S,) sum to one.
    """

    positions: np.ndarray
    weights: np.ndarray


def presence(ratio, trajectories, birth, death, initial, at=-1):
    """
    Sum over every sequence of existence and every trajectory, eq. (9) without any recursion.

    Parameters
    ----------
    ratio : (K, rows, cols) ndarray
        Log-likelihood ratio of each cell.
    trajectories : Trajectories
        Trajectories of at least K frames; one that leaves the frame ends there.
    birth, death, initial
        Probabilities of the chain.
    at
        Frame of the answer, 0 to K - 1, or -1 for the last.

    Returns
    -------
    float
        Log odds that there is an object in that frame, given all K.
    (2,) ndarray
        Mean column and row of the object within its best 3 x 3 cells, given that there is one.

    """
    count, at = len(ratio), at % len(ratio)
    likelihood = _likelihoods(ratio, trajectories)
    weight = {0: 0.0, 1: 0.0}
    here = {}
    for pattern in itertools.product((0, 1), repeat=count):
        product, where = initial if pattern[0] else 1.0 - initial, None
        for before, now in itertools.pairwise(pattern):
            if not before:
                product *= birth if now else 1.0 - birth
        for first, last in _runs_of_ones(pattern):
            each = likelihood(first, last, death)
            product *= each.sum()
            if first <= at <= last:
                where = at - first, each / each.sum()
        weight[pattern[at]] += product
        if where:
            here.setdefault(where[0], np.zeros_like(where[1]))
            here[where[0]] += product * where[1]
    positions = np.concatenate([trajectories.positions[:, age] for age in here])
    return (math.log(weight[1] / weight[0]),
            local_mean(positions, np.concatenate(list(here.values())), ratio.shape[1:]))


def local_mean(positions, weights, shape):
    """Return the mean of weighted positions (S, 2) in the 3 x 3 cells that hold most weight."""
    near = _near(positions, best_cell(positions, weights, shape))
    return weights[near] @ positions[near] / weights[near].sum()


def best_cell(positions, weights, shape):
    """Return column and row of the cell whose 3 x 3 cells hold most weight."""
    return max(
        ((col, row) for row, col in np.ndindex(*shape)),
        key=lambda cell: weights[_near(positions, cell)].sum())


def _near(positions, cell):
    return np.all(abs(np.floor(positions + 0.5) - cell) <= 1, axis=1)


def _likelihoods(ratio, trajectories):
    """Return the function that weights every trajectory from a first to a last frame."""
    count, rows, cols = ratio.shape
    col, row = np.floor(trajectories.positions[:, :count] + 0.5).astype(int).transpose(2, 0, 1)
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    inside = np.logical_and.accumulate(inside, axis=1)
    row, col = np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)

    def likelihood(first, last, death):
        length = last - first + 1
        frames = np.arange(first, last + 1)
        sums = ratio[frames, row[:, :length], col[:, :length]].sum(axis=1)
        weight = trajectories.weights * np.exp(sums) * (1.0 - death)**(length - 1)
        weight = np.where(inside[:, length - 1], weight, 0.0)
        if last == count - 1:
            return weight
        return weight * np.where(inside[:, length], death, 1.0)

    return likelihood


def _runs_of_ones(pattern):
    """Yield first and last index of each run of ones."""
    for value, group in itertools.groupby(enumerate(pattern), key=lambda item: item[1]):
        indices = [index for index, _ in group]
        if value:
            yield indices[0], indices[-1]


def grid_trajectories(shape, moves, kernel, history, count):
    """
    Enumerate every start cell and every sequence of moves, with its probability.

    ``kernel`` is (kept, n, dropped) and ``history`` (dropped, kept), as in ``MoveModel``.
    """
    rows, cols = shape
    order = {(1, 1): 0, (len(moves), 1): 1}.get(history.shape, 2)
    paths, weights = [], []
    for sequence in itertools.product(range(len(moves)), repeat=count - 1):
        paths.append(np.cumsum([(0, 0), *(moves[m] for m in sequence)], axis=0))
        weights.append(_sequence_prob(sequence, kernel, history, order))
    paths, weights = np.array(paths), np.array(weights)
    cells = np.array(list(itertools.product(range(rows), range(cols))))
    positions = (cells[:, None, None] + paths).reshape(-1, count, 2)[..., ::-1]
    return Trajectories(positions, np.tile(weights, len(cells)) / len(cells))


def _sequence_prob(sequence, kernel, history, order):
    """Sum the probability of a sequence of moves over the histories before it."""
    total = 0.0
    for dropped, kept in np.ndindex(*history.shape):
        product, (old, last) = history[dropped, kept], (dropped, kept)
        for move in sequence:
            product *= kernel[last, move, old]
            old, last = ((0, 0), (move, 0), (last, move))[order]
        total += product
    return total


def sampled_trajectories(shape, motion, count, samples, rng):
    """Draw trajectories in cells of one metre and frames of one second, by geometry."""
    rows, cols = shape
    position = rng.uniform(-0.5, [cols - 0.5, rows - 0.5], (samples, 2))
    speed = rng.uniform(motion.min_speed_mps, motion.max_speed_mps, samples)
    heading = rng.uniform(0.0, 2.0 * np.pi, samples)
    rates = np.deg2rad(motion.turn_rates_deg_s)
    mode = rng.integers(len(rates), size=samples)
    positions = [position]
    for _ in range(count - 1):
        leave = rng.random(samples) < 1.0 - motion.mode_transition(1.0)[0, 0]
        mode = np.where(leave, (mode + rng.integers(1, max(2, len(rates)), samples)), mode)
        mode %= len(rates)
        # An arc of circle: the chord lies half the turn ahead of the heading.
        turn = rates[mode]
        chord = speed * np.sinc(turn / (2.0 * np.pi))
        ahead = heading + turn / 2.0
        position = position + chord[:, None] * np.stack([np.cos(ahead), np.sin(ahead)], -1)
        heading = heading + turn
        positions.append(position)
    return Trajectories(np.stack(positions, axis=1), np.full(samples, 1.0 / samples))


@dataclass(frozen=True)
class Path:
    """An open path: last cell, measurements, and log probability of its moves [nat]."""

    cell: tuple[int, int]
    values: tuple[float, ...]
    log_prior: float = 0.0


@dataclass(frozen=True)
class PathTest:
    """The sequential test of Section IV-A, with thresholds on T_M; every path one by one."""

    intensity: float
    sigma: float
    most: int
    radius: int
    restart: str
    log_lower: float
    log_upper: float
    log_truncated: float
    log_move: dict | None = None

    def bound(self, log_threshold, count):
        """Return th'(M), the bound on T_M of eq. (6)."""
        return (self.sigma**2 / self.intensity * log_threshold
                + count * self.intensity / 2.0)

    def excess(self, path):
        """Return how far T_M lies above its upper bound, in nat."""
        count = len(path.values)
        log_threshold = self.log_truncated if count == self.most else max(
            self.log_upper, self.log_truncated)
        scale = self.intensity / self.sigma**2
        return (sum(path.values) - self.bound(log_threshold, count)) * scale + path.log_prior

    def run(self, frames):
        """Return for each frame the declared cells."""
        opened, declared = [], []
        for frame in frames:
            paths = [*self._extended(opened, frame), *self._started(opened, frame)]
            crossed = {(p.cell, len(p.values)) for p in paths if self.excess(p) > 0.0}
            declared.append({cell for cell, _ in crossed})
            opened = [
                path for path in paths
                if (path.cell, len(path.values)) not in crossed
                and len(path.values) < self.most and self._stays(path)]
        return declared

    def _stays(self, path):
        scale = self.intensity / self.sigma**2
        lower = self.bound(self.log_lower, len(path.values))
        return (sum(path.values) - lower) * scale + path.log_prior > 0.0

    def _extended(self, opened, frame):
        reach = range(-self.radius, self.radius + 1)
        for path, down, across in itertools.product(opened, reach, reach):
            cell = path.cell[0] + down, path.cell[1] + across
            if 0 <= cell[0] < frame.shape[0] and 0 <= cell[1] < frame.shape[1]:
                log_prior = self.log_move[down, across] if self.log_move else 0.0
                yield Path(cell, (*path.values, frame[cell]), path.log_prior + log_prior)

    def _started(self, opened, frame):
        for cell in np.ndindex(*frame.shape):
            used = any(max(abs(cell[0] - path.cell[0]), abs(cell[1] - path.cell[1]))
                       <= self.radius for path in opened)
            if self.restart == 'all' or not used:
                yield Path(cell, (frame[cell],))
