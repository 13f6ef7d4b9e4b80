# SPDX-License-Identifier: Apache-2.0
"""
Compiled loops over particles.

Each is one pass over B independent sets of N particles; arrays are C-contiguous.  The functions
that call them document what they compute, and tests hold them equal to plain NumPy.
"""

from __future__ import annotations

from lowsnr_common.core.compiled import compiled
import numpy as np


@compiled
def switch_modes(modes: np.ndarray, draw: np.ndarray, cumulative: np.ndarray) -> np.ndarray:
    """
    Return the modes (N,) after ``modes`` (N,), drawn by inversion.

    ``draw`` (N,) is uniform in [0, 1); ``cumulative`` (M, M - 1) holds the cumulative transition
    probabilities without the last, which is one.
    """
    after = np.empty_like(modes)
    for n in range(modes.size):
        count = 0
        for bound in cumulative[modes[n]]:
            count += draw[n] >= bound
        after[n] = count
    return after


@compiled
def move_states(
    states: np.ndarray, modes: np.ndarray, matrices: np.ndarray, factor: np.ndarray,
    noise: np.ndarray,
) -> None:
    """
    Replace standard normal noise (N, 4) by the next states, ``F(mode) state + factor noise``.

    ``matrices`` (M, 4, 4) holds F of each mode; ``factor`` (4, 4) is the Cholesky factor of Q.
    """
    position, speed, both = factor[0, 0], factor[1, 1], factor[1, 0]
    for n in range(len(states)):
        turn = matrices[modes[n]]
        along, across, cos, sin = turn[0, 1], turn[2, 1], turn[1, 1], turn[3, 1]
        x, v_x, y, v_y = states[n, 0], states[n, 1], states[n, 2], states[n, 3]
        e_x, e_y = noise[n, 0], noise[n, 2]
        noise[n, 0] = x + along * v_x - across * v_y + position * e_x
        noise[n, 1] = cos * v_x - sin * v_y + (both * e_x + speed * noise[n, 1])
        noise[n, 2] = across * v_x + y + along * v_y + position * e_y
        noise[n, 3] = sin * v_x + cos * v_y + (both * e_y + speed * noise[n, 3])


@compiled
def cell_ratio(
    frame: np.ndarray, states: np.ndarray, cell_size: float, intensity: float, scale: float,
) -> np.ndarray:
    """Return ``(2 z - I) scale`` of the cell z of each state, -inf outside, (B, N)."""
    runs, count = states.shape[:2]
    rows, cols = frame.shape[1:]
    ratio = np.empty((runs, count))
    for run in range(runs):
        for n in range(count):
            row = np.floor(states[run, n, 2] / cell_size + 0.5)
            col = np.floor(states[run, n, 0] / cell_size + 0.5)
            if 0.0 <= row < rows and 0.0 <= col < cols:
                ratio[run, n] = (2.0 * frame[run, int(row), int(col)] - intensity) * scale
            else:
                ratio[run, n] = -np.inf
    return ratio


@compiled
def blurred_ratio(
    frame: np.ndarray, states: np.ndarray, cell_size: float, reach: int, width: float,
    peak: float,
) -> np.ndarray:
    """Return the sum of ``h (2 z - h)`` over the cells z that the blur reaches, (B, N)."""
    runs, count = states.shape[:2]
    rows, cols = frame.shape[1:]
    ratio = np.empty((runs, count))
    spread = np.empty(2 * reach + 1)
    for run in range(runs):
        for n in range(count):
            x, y = states[run, n, 0], states[run, n, 2]
            row, col = np.floor(y / cell_size + 0.5), np.floor(x / cell_size + 0.5)
            if not (0.0 <= row < rows and 0.0 <= col < cols):
                ratio[run, n] = -np.inf
                continue
            left, right = max(int(col) - reach, 0), min(int(col) + reach + 1, cols)
            for j in range(left, right):
                spread[j - left] = np.exp(-(j * cell_size - x)**2 / (2.0 * width**2))
            total = 0.0
            for i in range(max(int(row) - reach, 0), min(int(row) + reach + 1, rows)):
                down = peak * np.exp(-(i * cell_size - y)**2 / (2.0 * width**2))
                for j in range(left, right):
                    signal = down * spread[j - left]
                    total += signal * (2.0 * frame[run, i, j] - signal)
            ratio[run, n] = total
    return ratio


@compiled
def systematic_indices(weights: np.ndarray, draw: np.ndarray, count: int) -> np.ndarray:
    """
    Return the particles that systematic resampling draws, (B, count), in ascending order.

    ``weights`` (B, N) are at least 0 and need not sum to one; weights that are all 0 count as
    equal.  ``draw`` (B,) in [0, 1) places the points ``(i + draw) / count`` on the cumulative
    weights.
    """
    runs, size = weights.shape
    chosen = np.empty((runs, count), dtype=np.intp)
    edges = np.empty(size)
    for run in range(runs):
        total, last = 0.0, -1
        for n in range(size):
            total += weights[run, n]
            edges[n] = total
            if weights[run, n] > 0.0:
                last = n
        if last < 0:
            edges[:] = np.arange(1, size + 1)
            total, last = float(size), size - 1
        # The first point beyond each edge; a point draws as many particles as edges are before it.
        first, scale = np.zeros(count + 1, dtype=np.intp), count / total
        for n in range(size):
            first[min(max(int(np.ceil(edges[n] * scale - draw[run])), 0), count)] += 1
        passed = 0
        for i in range(count):
            passed += first[i]
            # A point that rounding puts at 1.0 belongs to the last particle with weight.
            chosen[run, i] = min(passed, last)
    return chosen
