# SPDX-License-Identifier: Apache-2.0
"""
Random streams: from one root seed, an independent stream for each use and run.

Normal numbers come from :func:`standard_normal`, which draws many of them in less time than
numpy and to the same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
import math

from lowsnr_common.core.compiled import compiled
from lowsnr_common.core.compiled import is_loaded
import numpy as np

# The position in this tuple is the key of the stream: append, never reorder.
_USES = ('truth', 'noise', 'detector', 'tracker', 'calibration')
# Numbers from which on a compiled loop is faster: a call takes 5 us, and loading the compiler,
# where no other loop has done so, half a second.
_MANY, _MANY_TO_LOAD = 1_000, 100_000


def stream(seed: int, use: str, run: int = 0) -> np.random.Generator:
    """
    Return the generator of one use in one run.

    Its seed is the child that ``numpy.random.SeedSequence(seed).spawn`` yields for the run and
    then for the use; a node needs the root seed alone to get it.

    Parameters
    ----------
    seed
        Root seed of the experiment.
    use
        ``'truth'``, ``'noise'``, ``'detector'``, ``'tracker'`` or ``'calibration'``.
    run
        Number of the Monte Carlo run; a graph run is run 0.

    Raises
    ------
    ValueError
        If the use is not one of these.

    """
    if use not in _USES:
        raise ValueError(f'stream {use!r} is not one of {", ".join(_USES)}')
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(run, _USES.index(use))))


def standard_normal(shape: Sequence[int], rng: np.random.Generator) -> np.ndarray:
    """
    Return standard normal numbers: those of numpy, to the bit, in a third of the time if many.

    Parameters
    ----------
    shape
        Shape of the result.
    rng
        Source of randomness; its state is afterwards that after ``rng.standard_normal(shape)``.

    """
    count = math.prod(shape)
    few = count < _MANY or (count < _MANY_TO_LOAD and not is_loaded())
    if few or not isinstance(rng, np.random.Generator):  # such as the generators of many runs
        return rng.standard_normal(shape)
    drawn = np.empty(shape)
    _fill(rng, drawn.reshape(-1))
    return drawn


@compiled
def _fill(rng: np.random.Generator, drawn: np.ndarray) -> None:
    """Draw standard normal numbers as numpy does, without a branch for the sign."""
    for n in range(len(drawn)):
        drawn[n] = rng.standard_normal()
